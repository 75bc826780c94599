// Positions as people type them: two numbers, and perhaps a heading.

import { Problem } from "./api.js";

/** The parts of a position in `frame` (metres or degrees) as texts, {} where nothing is typed; raises Problem. */
export function typedPosition(text, frame) {
  const numbers = text.split(/[\s,;]+/).filter(Boolean);
  if (numbers.length === 1 || numbers.length > 3)
    throw new Problem(0, {
      title: "Position",
      detail: `two numbers are needed and perhaps a heading, as in 12.5, 3.0, 90; not ${text}`,
    });
  const names = frame === "metres" ? ["x", "y", "heading"] : ["lat", "lon", "heading"];
  return Object.fromEntries(numbers.map((value, index) => [names[index], value]));
}

/** A choice between metres and degrees. */
export const FRAMES = [
  ["metres", "metres: x, y, heading"],
  ["degrees", "degrees: lat, lon, heading"],
];
