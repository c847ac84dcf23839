// Okabe and Ito's colours, which colour-blind people can distinguish; the last two replace yellow and
// black, which are invisible in one of the themes. Further clusters are drawn dashed.
export const PALETTE = [
  "#E69F00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#8C6BB1", "#9A8B4F",
];

export const colourOf = (slot) => PALETTE[slot % PALETTE.length];
export const isDashed = (slot) => slot >= PALETTE.length;

const values = new Map(); // of colour variables, until the theme changes
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => values.clear());

/** The value of a colour variable of style.css in the present theme. */
export function themed(name) {
  if (!values.has(name)) {
    values.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  }
  return values.get(name);
}

/** Fit a canvas to its box in device pixels; its drawing context, in CSS pixels. */
export function prepared(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height, ratio };
}

/** A number with so many decimals, and no sign if it is 0 by them. */
export const fixed = (value, decimals) => value?.toFixed(decimals).replace(/^-(?=[0.]*$)/, "");

export const percent = (p) => (p >= 0.9995 ? "100 %" : p < 0.001 ? "< 0.1 %" : `${(100 * p).toFixed(p < 0.0995 ? 1 : 0)} %`);
