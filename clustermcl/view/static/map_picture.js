// The map's cells as a picture of its own, drawn once.
import { themed } from "./palette.js";

const MAX_SIDE = 4096; // a larger map is reduced, walls win

/** Fetch the cells of a map, one byte each; null: the server has another map now. */
export async function fetchedCells({ digest, rows, cols, packed }) {
  const answer = packed ? unpacked(packed) : await fetch(`map/${digest}`);
  const cells = new Uint8Array(await answer.arrayBuffer());
  return answer.ok && cells.length === rows * cols ? cells : null;
}

/** Unpack the cells of a saved page: base64 of zlib. */
export function unpacked(packed) {
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate")));
}

/** The map as a picture of its own, drawn once; row 0 of the cells is its lowest line. */
export function pictureOf({ frame: { rows, cols }, cells }) {
  const every = Math.ceil(Math.max(rows, cols) / MAX_SIDE);
  const width = Math.ceil(cols / every), height = Math.ceil(rows / every);
  const picture = document.createElement("canvas");
  [picture.width, picture.height] = [width, height];
  const context = picture.getContext("2d");
  const image = context.createImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  const [free, occupied, unknown] = ["--map-free", "--map-occupied", "--map-unknown"].map(littleEndian);
  pixels.fill(unknown);
  for (let row = 0; row < rows; row++) {
    const line = (height - 1 - Math.floor(row / every)) * width;
    for (let col = 0; col < cols; col++) {
      const cell = cells[row * cols + col], at = line + Math.floor(col / every);
      if (cell === 1) pixels[at] = occupied;
      else if (cell === 0 && pixels[at] !== occupied) pixels[at] = free;
    }
  }
  context.putImageData(image, 0, 0);
  return picture;
}

function littleEndian(name) {
  const [red, green, blue] = themed(name).match(/[0-9a-f]{2}/gi).map((digits) => parseInt(digits, 16));
  return ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
}
