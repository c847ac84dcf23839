// Lists of buttons that are filled again with each step.
const RELEASED_MS = 100;

/** Fill a list, but not while one of its buttons is pressed: it would be replaced, and its click lost. */
export function whenReleased(list, fill) {
  clearTimeout(list.waiting);
  if (list.matches(":active")) list.waiting = setTimeout(whenReleased, RELEASED_MS, list, fill);
  else fill();
}
