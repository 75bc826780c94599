// Positions of photos by a click on the map's plan.

import { h, problemBox } from "./dom.js";
import { plan, surroundings } from "./plan.js";

/**
 * Details with the plan of a map. `map()` promises its name, `next()` gives the photo that is placed now,
 * {name, put(position)}, or null.
 * Gives {element, told, draw}; `told` is to be called when another photo is next, `draw` when another map is chosen.
 */
export function placing(map, next) {
  const body = h("div");
  let drawn = 0;
  const name = h("strong", {});
  const said = h("p", {}, "Click where this was taken: ", name);
  const element = h("details", { ontoggle: draw }, h("summary", {}, "Set positions on the plan"), body);

  async function draw() {
    const mine = ++drawn;
    if (!element.open) return;
    try {
      const points = await surroundings(await map()).catch((error) => {
        if (error.status === 404) return []; // a map that is made by its first photo
        throw error;
      });
      if (mine !== drawn) return; // another map was chosen meanwhile
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

  return { element, told, draw };
}
