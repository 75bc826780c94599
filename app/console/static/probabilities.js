// Probabilities of places, of an answer and of a drive.

import { bars, count, h, place as inWords } from "./dom.js";

const MOST_PLACES = 6;
const ALONE = { matched: "recognised", ambiguous: "perhaps a place, but not sure", no_match: "not recognised" };

/** Bars of places, likeliest first, and of none of them. */
export function probabilities(answer) {
  const shown = answer.places.slice(0, MOST_PLACES);
  const others = answer.places.slice(MOST_PLACES);
  const spot = (position) => position && inWords({ ...position, heading: null });
  const several = answer.maps ?? [];
  const name = ({ map, place, position, views }) =>
    (several.length ? `${map}: ` : "") + (place ?? spot(position) ?? `view ${views[0].id.slice(-6)}`);
  const rows = shown.map((one) => [name(one), one.probability]);
  if (others.length) {
    rows.push([count(others.length, "other place"), others.reduce((sum, one) => sum + one.probability, 0)]);
  }
  return bars([...rows, ["nowhere: none of these", answer.nowhere, "nowhere"]]);
}

/** What the images of a drive say together, and this one alone. */
export function drivePanel(drive) {
  const places = drive.posterior.map((one) => ({ ...one, views: one.views.map((id) => ({ id })) }));
  return h(
    "section",
    { class: "panel", "aria-label": "The drive" },
    h("h2", {}, "The drive"),
    h(
      "p",
      {},
      drive.images === 1 ? "This is its first image. " : `${drive.images} images count together. `,
      "This one alone: ",
      h("strong", {}, ALONE[drive.single_frame_status]),
      ".",
    ),
    probabilities({ places, nowhere: drive.nowhere }),
  );
}
