// What both pages share: the model's situations with their colours, and the hand in WebAssembly.
"use strict";

const COLOURS = { nothing: "#bbbbbb", grasp: "#56b4e9", "safe slip": "#009e73", "risky slip": "#d55e00", unknown: "#e3c76a" };
const at = (id) => document.getElementById(id);

/** The exports of a WebAssembly module that was packed by gzip and written in base64. */
async function openHand(packed) {
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const { instance } = await WebAssembly.instantiate(await new Response(plain).arrayBuffer(), {});
  return instance.exports;
}

/** A canvas in the pixels of the screen -> its pen, scaled to CSS pixels. */
function penOf(canvas) {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = canvas.clientWidth * ratio;
  canvas.height = canvas.clientHeight * ratio;
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  pen.font = "12px system-ui, sans-serif";
  return pen;
}

/** A list of names with the colour of each: of areas, and of lines. */
function fillLegend(list, areas, lines) {
  for (const [name, colour] of [...Object.entries(areas), ...Object.entries(lines)]) {
    const item = document.createElement("li");
    const swatch = document.createElement("span");
    swatch.className = name in lines ? "swatch line" : "swatch";
    swatch.style.background = colour;
    item.append(swatch, name);
    list.append(item);
  }
}
