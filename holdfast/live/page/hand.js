// The hand as its card describes it: the contacts of either side beside the object, discs and arrows on the sensors.

const SVG = "http://www.w3.org/2000/svg";
const PAD_PX = 15, ARROW_PX = 44, MARGIN_PX = 62, SIDES_PX = 110, NEAR_PX = 60, HIGH_PX = 330, LONE_MM = 20;
const LEAST = { N: 0.5, uT: 50, count: 50 };
const FADES = 0.995;  // the scales follow a falling force slowly

let pads = [];
let largest = { press: 0, along: 0 };

function make(name, attributes, parent) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent.append(element);
  return element;
}

const range = (values) => [Math.min(...values), Math.max(...values)];

/** Pixels a mm: neighbours are apart, and the whole is not too high. */
function scaleOf(sides) {
  const distances = sides.flatMap((side) => side.flatMap((one, k) => side.slice(k + 1).map((other) => Math.hypot(one.x_mm - other.x_mm, one.y_mm - other.y_mm))));
  const [low, high] = range(sides.flat().map((one) => one.y_mm));
  return Math.min(NEAR_PX / Math.min(LONE_MM, ...distances.filter((mm) => mm > 0)), HIGH_PX / Math.max(high - low, LONE_MM));
}

/** The places of the contacts in px: the sides left and right of the object, each around its middle. */
function placed(contacts) {
  const sides = [0, 1].map((side) => contacts.filter((one) => (one.side ?? 0) === side)).filter((side) => side.length);
  const scale = scaleOf(sides);
  const [, top] = range(contacts.map((one) => one.y_mm));
  const places = new Map();
  let right = 0;
  for (const [k, side] of sides.entries()) {
    const [from, to] = range(side.map((one) => one.x_mm));
    const left = k ? right + SIDES_PX : MARGIN_PX;
    for (const one of side) places.set(one, [left + (one.x_mm - from) * scale, MARGIN_PX + (top - one.y_mm) * scale]);
    right = left + (to - from) * scale;
  }
  const [low] = range(contacts.map((one) => one.y_mm));
  return { places, width: right + MARGIN_PX, height: 2 * MARGIN_PX + (top - low) * scale, sides: sides.length };
}

/** The soft pad around contacts that share one, or around one that is alone. */
function drawPad(svg, points) {
  const [[left, right], [top, bottom]] = [range(points.map(([x]) => x)), range(points.map(([, y]) => y))];
  const edge = 2 * PAD_PX;
  make("rect", { class: "skin", x: left - edge, y: top - edge, width: right - left + 2 * edge, height: bottom - top + 2 * edge, rx: edge }, svg);
}

/** Draw the hand of these contacts: name, side (0, 1 or null), x_mm, y_mm, pad, sensed. */
export function build(svg, contacts) {
  svg.replaceChildren();
  largest = { press: 0, along: 0 };
  const { places, width, height, sides } = placed(contacts);
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const byPad = new Map();
  for (const [k, one] of contacts.entries()) {
    const key = one.pad || k;
    byPad.set(key, [...(byPad.get(key) ?? []), places.get(one)]);
  }
  if (sides === 2) {
    const edge = range(contacts.filter((one) => one.side === 0).map((one) => places.get(one)[0]))[1];
    make("rect", { class: "object", x: edge + SIDES_PX / 2 - 9, y: 8, width: 18, height: height - 16, rx: 9 }, svg);
  }
  for (const points of byPad.values()) drawPad(svg, points);
  for (const one of contacts.filter(({ sensed }) => !sensed)) make("circle", { class: "bare", r: PAD_PX / 2, cx: places.get(one)[0], cy: places.get(one)[1] }, svg);

  pads = contacts.filter(({ sensed }) => sensed).map((one) => {
    const [x, y] = places.get(one);
    const group = make("g", { transform: `translate(${x} ${y})` }, svg);
    make("circle", { class: "pad", r: PAD_PX }, group);
    // every second one of a row has its name below, so that neighbours' names do not meet
    const before = contacts.filter((other) => other.sensed && other.side === one.side && other.y_mm === one.y_mm && other.x_mm < one.x_mm);
    return {
      group,
      press: make("circle", { class: "press", r: 0 }, group),
      arrow: make("line", { class: "arrow", x1: 0, y1: 0, x2: 0, y2: 0 }, group),
      head: make("path", { class: "head", d: "" }, group),
      label: make("text", { y: before.length % 2 ? 28 : -20 }, group),
      name: one.name,
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
