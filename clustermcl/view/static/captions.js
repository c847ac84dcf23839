// Captions of a demo: what happens now, in one sentence.
const $ = (id) => document.getElementById(id);
const NUMBERS = ["No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine", "Ten"];
const PROBABLE = 0.04;
const SEEN = { cross_feature: "Localized: it has seen the cabinet, which only one arm has." };
const ALIKE = { cross: "arms", cross_feature: "arms" };

/** @return the sentence, and whether "Again" is offered */
export function captionOf({ state, places, last }, world) {
  const alike = ALIKE[world] ? places.filter((place) => place.p > PROBABLE).length : 0;
  if (last) return ["The run has ended.", true];
  if (state === "localized") return [SEEN[world] ?? "Localized: what the laser has seen fits one place alone.", true];
  if (state === "lost") return ["Lost: no place explains the scan, so the whole map is searched.", false];
  if (state !== "ambiguous") return ["Where is the robot? The first search tries the whole map.", false];
  if (alike > 1) return [`${NUMBERS[alike] ?? alike} ${ALIKE[world]} look alike: the scan fits all of them, so none is chosen yet.`, false];
  if (places.length > 1) return [`${NUMBERS[places.length] ?? places.length} places are possible, so none is chosen yet.`, false];
  return ["One place is likely, but not certain yet.", false];
}

/**
 * @param step the newest; null: there is none, or a past step is shown
 * @param world where the robot drives
 */
export function showCaption(step, world) {
  $("caption").hidden = !step;
  if (!step) return;
  const [text, mayRepeat] = captionOf(step, world);
  if ($("caption-text").textContent !== text) $("caption-text").textContent = text;
  $("again").hidden = !mayRepeat;
}
