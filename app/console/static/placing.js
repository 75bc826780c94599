// Positions of photos by a click on the map's plan.

import { h, problemBox } from "./dom.js";
import { plan, surroundings } from "./plan.js";

/**
 * Details with the plan of a map. `map()` names it, `next()` gives the photo that is placed now, {name, put(position)},
 * or null.
 * Gives {element, told}; `told` is to be called when another photo is next.
 */
export function placing(map, next) {
  const body = h("div");
  const name = h("strong", {});
  const said = h("p", {}, "Click where this was taken: ", name);
  const element = h("details", { ontoggle: draw }, h("summary", {}, "Set positions on the plan"), body);

  async function draw() {
    if (!element.open) return;
    try {
      const points = await surroundings(map());
      const { element: picture } = plan(points, { placed });
      body.replaceChildren(
        ...(points.length
          ? [said, picture]
          : ["This map has no positions yet: the first ones come from fields or a CSV file."]),
      );
      told();
    } catch (error) {
      body.replaceChildren(problemBox(error));
    }
  }

  function told() {
    name.textContent = next()?.name ?? "no photo is left without a position";
  }

  function placed(position) {
    next()?.put(position);
    told();
  }

  return { element, told };
}
