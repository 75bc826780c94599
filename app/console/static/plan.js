// A plan of positions, drawn without tiles: metres of the map's frame, or degrees laid flat around their middle.

import { call, pages } from "./api.js";
import { count, h } from "./dom.js";

const METRES_PER_DEGREE = 111_320;
const MARGIN = 28;
const NEAR_PX = 14;
const MANY = 2000; // points that take a while to draw
const REDRAWN_MS = 400;
const PAGE = 500;
const MOST = 10_000; // views that give a map its shape
const AROUND_M = 50;

// By the page, since the window would keep each plan that listens to it, with all its points.
window.addEventListener("theme", () => {
  for (const canvas of document.querySelectorAll("canvas.plan")) canvas.dispatchEvent(new Event("theme"));
});

/** Degrees of longitude within 180 of 0: positions on both sides of the date line are near each other. */
const turned = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;

/** Metres of a degree of longitude at a latitude; above 0 even at a pole, where all longitudes are one point. */
const metresEast = (lat) => METRES_PER_DEGREE * Math.max(Math.cos((lat * Math.PI) / 180), 1e-6);

const isGeographic = ({ lat }) => lat !== null && lat !== undefined;

/** A position as metres east and north; `middle` {lat, lon} is where degrees are laid flat. */
function flat(position, middle) {
  if (position.x !== null && position.x !== undefined) return [position.x, position.y];
  if (!isGeographic(position)) return null;
  return [turned(position.lon - middle.lon) * metresEast(middle.lat), position.lat * METRES_PER_DEGREE];
}

/**
 * A plan of points {position, kind, name}; kinds: view, match, first.
 * circle: {position, radius in m or null}. picked(point) is called for a point that was clicked, placed(position) for
 * any spot that was.
 * Gives {element, add(points), show(points)}; `show` replaces the points that were there before.
 */
export function plan(points, { circle = null, picked = null, placed = null } = {}) {
  const canvas = h("canvas", { class: picked || placed ? "plan picks" : "plan", role: "img" });
  const nearestName = h("p", { class: "quiet" });
  let all = [...points];
  let drawn = []; // [pixel x, pixel y, point]
  let toMap = null;

  function draw() {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width) return;
    const ratio = window.devicePixelRatio || 1;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const paint = canvas.getContext("2d");
    paint.scale(ratio, ratio);
    paint.font = "12px system-ui, sans-serif";
    const degrees = all.map((one) => one.position).filter(isGeographic);
    const middle = circle && isGeographic(circle.position) ? circle.position : degrees[Math.floor(degrees.length / 2)];
    const spots = all.map((point) => [flat(point.position, middle), point]).filter(([spot]) => spot);
    const centre = circle && flat(circle.position, middle);
    const reach = circle?.radius ?? 0;
    const corners = [
      ...spots.map(([spot]) => spot),
      ...(centre
        ? [
            [centre[0] - reach, centre[1] - reach],
            [centre[0] + reach, centre[1] + reach],
          ]
        : []),
    ];
    canvas.setAttribute(
      "aria-label",
      `Plan with ${count(spots.length, "position")}${centre ? " and where your photo was taken" : ""}`,
    );
    if (!corners.length) {
      drawn = [];
      return;
    }
    const [west, east] = range(corners, 0);
    const [south, north] = range(corners, 1);
    const scale = Math.min(
      (width - 2 * MARGIN) / Math.max(east - west, 1),
      (height - 2 * MARGIN) / Math.max(north - south, 1),
    );
    const x = (value) => width / 2 + (value - (west + east) / 2) * scale;
    const y = (value) => height / 2 - (value - (south + north) / 2) * scale;
    toMap = (left, top) => {
      const [along, up] = [
        (left - width / 2) / scale + (west + east) / 2,
        (height / 2 - top) / scale + (south + north) / 2,
      ];
      if (!degrees.length) return { x: along, y: up };
      return { lat: up / METRES_PER_DEGREE, lon: turned(middle.lon + along / metresEast(middle.lat)) };
    };
    drawn = spots.map(([spot, point]) => [x(spot[0]), y(spot[1]), point]);
    const radius = drawn.length > MANY ? 1.5 : drawn.length > 300 ? 2.5 : 4;
    for (const [kind, name, bigger] of [
      ["view", "--quiet", 0],
      ["match", "--accent", 2],
      ["first", "--good", 4],
    ]) {
      paint.fillStyle = colour(name);
      for (const [left, top, point] of drawn) {
        if (point.kind !== kind) continue;
        paint.beginPath();
        paint.arc(left, top, radius + bigger, 0, 2 * Math.PI);
        paint.fill();
      }
    }
    label(paint, width);
    if (centre) around(paint, x(centre[0]), y(centre[1]), reach * scale);
    scaleBar(paint, scale, height);
  }

  /** Names beside their points, the best match first; one that would cover another is left out. */
  function label(paint, width) {
    const named = drawn.filter(([, , { kind, name }]) => name && kind !== "view");
    const taken = [];
    for (const [left, top, { kind, name }] of named.sort(
      (a, b) => (b[2].kind === "first") - (a[2].kind === "first"),
    )) {
      const long = paint.measureText(name).width;
      const begin = left + 10 + long < width ? left + 10 : Math.max(2, left - 10 - long);
      const box = { begin, end: begin + long, top: top - 6 };
      if (taken.some((one) => begin < one.end && box.end > one.begin && Math.abs(one.top - box.top) < 15)) continue;
      taken.push(box);
      paint.fillStyle = colour(kind === "first" ? "--good" : "--accent");
      paint.fillText(name, begin, box.top);
    }
  }

  function around(paint, left, top, reach) {
    paint.strokeStyle = colour("--bad");
    paint.lineWidth = 2;
    paint.beginPath();
    paint.arc(left, top, Math.max(reach, 7), 0, 2 * Math.PI);
    paint.moveTo(left - 5, top);
    paint.lineTo(left + 5, top);
    paint.moveTo(left, top - 5);
    paint.lineTo(left, top + 5);
    paint.stroke();
  }

  function scaleBar(paint, scale, height) {
    const wanted = 90 / scale;
    const power = 10 ** Math.floor(Math.log10(wanted));
    const length = [5, 2, 1].map((step) => step * power).find((one) => one <= wanted);
    paint.strokeStyle = paint.fillStyle = colour("--ink");
    paint.lineWidth = 2;
    paint.beginPath();
    paint.moveTo(12, height - 16);
    paint.lineTo(12, height - 12);
    paint.lineTo(12 + length * scale, height - 12);
    paint.lineTo(12 + length * scale, height - 16);
    paint.stroke();
    paint.fillText(length >= 1000 ? `${length / 1000} km` : `${length} m`, 16, height - 18);
  }

  function colour(name) {
    nearestName.style.color = `var(${name})`;
    const found = getComputedStyle(nearestName).color;
    nearestName.style.color = "";
    return found;
  }

  canvas.addEventListener("click", (event) => {
    const found = nearest(event.offsetX, event.offsetY);
    if (placed && toMap) placed(toMap(event.offsetX, event.offsetY));
    else if (picked && found) picked(found);
  });
  canvas.addEventListener("mousemove", (event) => {
    nearestName.textContent = nearest(event.offsetX, event.offsetY)?.name ?? "";
  });
  function nearest(left, top) {
    let [best, least] = [null, NEAR_PX];
    for (const [x, y, point] of drawn) {
      const distance = Math.hypot(x - left, y - top);
      if (distance < least) [best, least] = [point, distance];
    }
    return best;
  }
  new ResizeObserver(draw).observe(canvas);
  canvas.addEventListener("theme", draw);
  let soon = null;
  /** Draw once for all points that come within a short while. */
  function drawSoon() {
    soon ??= setTimeout(
      () => {
        soon = null;
        draw();
      },
      all.length > MANY ? REDRAWN_MS : 0,
    );
  }
  return {
    element: h("div", {}, canvas, nearestName),
    add: (more) => {
      for (const point of more) all.push(point);
      drawSoon();
    },
    show: (points) => {
      all = [...points];
      drawSoon();
    },
  };
}

/** Points for views of a map around some positions, the first of them in the middle. */
export async function surroundings(map, positions) {
  const [middle] = positions;
  const spots = positions.map((one) => flat(one, middle)).filter(Boolean);
  const far = Math.max(...spots.map(([x, y]) => Math.hypot(x - spots[0][0], y - spots[0][1])));
  const query = { map, limit: PAGE, ...near(middle, Math.max(AROUND_M, 2 * far)) };
  const { views } = await call("GET", "/views", { query });
  return views.filter((view) => view.position).map(pointOf);
}

/** Give `add` the points for the views of a map that have a position, page by page, while they are `wanted`. */
export async function outline(map, add, wanted) {
  const list = pages("/views", { map, limit: PAGE });
  for (let read = 0; read < MOST; read += PAGE) {
    const { value, done } = await list.next();
    if (done || !wanted()) return;
    add(value.views.filter((view) => view.position).map(pointOf));
  }
}

/** Parameters of a list of the views within some metres of a position; null where that has no coordinates. */
export function near(position, within) {
  if (typeof position?.x === "number") return { near: `${position.x},${position.y},${within}`, frame: "map" };
  if (typeof position?.lat === "number") return { near: `${position.lat},${position.lon},${within}`, frame: "geo" };
  return null;
}

/** A view as a point of a plan. */
export function pointOf({ id, place, position }) {
  return { position, kind: "view", name: place ?? id.slice(-6), id };
}

function range(corners, axis) {
  let [least, most] = [Infinity, -Infinity];
  for (const corner of corners) {
    least = Math.min(least, corner[axis]);
    most = Math.max(most, corner[axis]);
  }
  return [least, most];
}
