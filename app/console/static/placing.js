// Gives photos positions by clicks on the map's plan.

import { h, problemBox } from "./dom.js";
import { outline, plan } from "./plan.js";

/**
 * Details with the plan of a map. `map()` promises its name, `next()` gives the photo that is placed now,
 * {name, put(position)}, or null.
 * Gives {element, update, draw}; call `update` when another photo is next, `draw` when another map is chosen.
 */
export function placing(map, next) {
  const body = h("div");
  let drawn = 0;
  const name = h("strong", {});
  const instruction = h("p", {}, "Click where this was taken: ", name);
  const element = h("details", { ontoggle: draw }, h("summary", {}, "Set positions on the plan"), body);

  async function draw() {
    const mine = ++drawn;
    if (!element.open) return;
    const { element: picture, add } = plan([], { placed });
    let shown = false;
    const show = (points) => {
      if (!points.length) return;
      add(points);
      if (shown) return;
      shown = true;
      body.replaceChildren(instruction, picture);
      update();
    };
    try {
      await outline(await map(), show, () => mine === drawn).catch((error) => {
        if (error.status !== 404) throw error; // the map is still to be made, by its first photo
      });
      if (mine !== drawn) return; // another map was chosen meanwhile
      if (!shown) body.replaceChildren("This map has no positions yet: the first ones come from fields or a CSV file.");
    } catch (error) {
      if (mine !== drawn) return;
      if (!shown) body.replaceChildren();
      body.append(problemBox(error)); // below as much of the plan as came
    }
  }

  function update() {
    name.textContent = next()?.name ?? "no photo is left without a position";
  }

  function placed(position) {
    next()?.put(position);
    update();
  }

  return { element, update, draw };
}
