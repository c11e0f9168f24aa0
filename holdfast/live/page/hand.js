// The hand: a drawing of six fingertips, or a row of pads for another number; discs and arrows on them.

const SVG = "http://www.w3.org/2000/svg";
const NAMES = ["thumb 1", "thumb 2", "index", "middle", "ring", "little"];
// A right hand seen from its palm. Each finger: where it begins, where it ends.
const BONES = [[[222, 210], [292, 128]], [[196, 150], [214, 62]], [[160, 144], [164, 36]], [[124, 150], [114, 54]], [[92, 166], [68, 92]]];
const PADS = [[290, 130], [256, 170], [214, 64], [164, 38], [114, 56], [68, 94]];
const PALM = "M92 160 L196 146 L226 210 L196 276 L110 276 Z";
const PAD_PX = 15, ARROW_PX = 44;
const LEAST = { N: 0.5, uT: 50, count: 50 };
const FADES = 0.995;  // the scales follow a falling force slowly

let pads = [];
let largest = { press: 0, along: 0 };

export const nameOf = (k, count) => (count === NAMES.length ? NAMES[k] : `finger ${k + 1}`);

function make(name, attributes, parent) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent.append(element);
  return element;
}

/** Draw the hand for a number of fingers. */
export function build(svg, count) {
  svg.replaceChildren();
  largest = { press: 0, along: 0 };
  const isHand = count === NAMES.length;
  const across = Math.min(count, 6);
  const places = isHand ? PADS : Array.from({ length: count }, (_, k) => [50 + 90 * (k % across), 50 + 90 * Math.floor(k / across)]);
  svg.setAttribute("viewBox", isHand ? "20 -14 330 306" : `0 0 ${90 * across + 10} ${90 * Math.ceil(count / across) + 20}`);
  if (isHand) {
    for (const [kind, width] of [["edge", 40], ["palm", 35]]) {
      for (const [from, to] of BONES) make("line", { class: kind, x1: from[0], y1: from[1], x2: to[0], y2: to[1], "stroke-width": width }, svg);
      make("path", { class: kind, d: PALM, "stroke-width": width - 6 }, svg);
    }
  }
  pads = places.map(([x, y], k) => {
    const group = make("g", { transform: `translate(${x} ${y})` }, svg);
    make("circle", { class: "pad", r: PAD_PX }, group);
    return {
      group,
      press: make("circle", { class: "press", r: 0 }, group),
      arrow: make("line", { class: "arrow", x1: 0, y1: 0, x2: 0, y2: 0 }, group),
      head: make("path", { class: "head", d: "" }, group),
      label: make("text", { y: isHand && k === 1 ? 34 : -22 }, group),
      name: nameOf(k, count),
    };
  });
}

/** A round number of at least this: 1, 2 or 5 times a power of ten. */
function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((k) => k * power).find((one) => one >= value * 0.999);
}

/** Show the forces [S][3] of one sample; valid [S]. Returns a sentence on the scale. */
export function show(forces, valid, unit) {
  const good = forces.filter((_, k) => valid[k]);
  const most = { press: good.map(([, , z]) => Math.abs(z ?? 0)), along: good.map(([x, y]) => Math.hypot(x ?? 0, y ?? 0)) };
  const full = {};
  for (const name of ["press", "along"]) {
    largest[name] = Math.max(largest[name] * FADES, LEAST[unit] ?? 1, ...most[name]);
    full[name] = roundUp(largest[name]);
  }
  forces.forEach((force, k) => showPad(pads[k], force, valid[k], full));
  return `Disc: normal force, ${full.press} ${unit} fill the ring. Arrow: force along the skin, the longest is ${full.along} ${unit}, in the sensor's x (right) and y (up).`;
}

function showPad(pad, [x, y, z], good, full) {
  pad.group.setAttribute("class", good ? "" : "lost");
  pad.label.textContent = good ? pad.name : `${pad.name} lost`;
  pad.press.setAttribute("r", good ? PAD_PX * Math.sqrt(Math.min(1, Math.max(0, z ?? 0) / full.press)) : 0);
  const [dx, dy] = good ? [(ARROW_PX * (x ?? 0)) / full.along, (-ARROW_PX * (y ?? 0)) / full.along] : [0, 0];
  const length = Math.hypot(dx, dy);
  pad.arrow.setAttribute("x2", dx);
  pad.arrow.setAttribute("y2", dy);
  pad.arrow.setAttribute("visibility", length > 1 ? "visible" : "hidden");
  if (length <= 4) { pad.head.setAttribute("d", ""); return; }
  const [ux, uy] = [dx / length, dy / length];
  pad.head.setAttribute("d", `M${dx + 5 * ux} ${dy + 5 * uy} L${dx - 5 * uy} ${dy + 5 * ux} L${dx + 5 * uy} ${dy - 5 * ux} Z`);
}
