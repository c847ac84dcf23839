// Captions of a demo: what happens now, in one sentence.
const $ = (id) => document.getElementById(id);
const NUMBERS = ["No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine", "Ten"];
const PROBABLE = 0.04;

/** @return the sentence, and whether the story can be told again from there */
export function captionOf({ state, places, last }) {
  const count = places.filter((place) => place.p > PROBABLE).length;
  if (last) return ["The run has ended.", true];
  if (state === "localized") return ["Localized: what the laser has seen fits one place alone.", true];
  if (state === "lost") return ["Lost: no place explains the scan, so the whole map is searched.", false];
  if (count > 1) return [`${NUMBERS[count] ?? count} places look alike: the scan fits all of them, so none is chosen yet.`, false];
  return ["Where is the robot? The first search tries the whole map.", false];
}

/**
 * @param step the newest; null: there is none yet, or another one is looked back at
 * @param again starts the story once more
 */
export function showCaption(step, again) {
  $("caption").hidden = !step;
  if (!step) return;
  const [text, mayRepeat] = captionOf(step);
  if ($("caption-text").textContent !== text) $("caption-text").textContent = text;
  $("again").hidden = !mayRepeat;
  $("again").onclick = again;
}
