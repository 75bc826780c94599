// The choice of a map, the same on every screen of this tab.

import { call } from "./api.js";
import { h } from "./dom.js";
import { ofTab } from "./remembered.js";

const CHOSEN = "revisit-map";

export const chosenMap = () => ofTab.getItem(CHOSEN) ?? "default";
export const chooseMap = (name) => ofTab.setItem(CHOSEN, name);

/**
 * A select of the maps. `refresh` fetches their names and counts, and may choose one; `facts` are those of the chosen
 * map; `chosen` promises its name, and fetches the maps again where that failed before.
 */
export function mapSelect(changed = () => {}) {
  const select = h("select", {
    onchange: () => {
      chooseMap(select.value);
      changed(facts());
    },
  });
  let maps = [];
  const facts = () => maps.find((one) => one.name === select.value) ?? null;
  let refreshed = null;
  function refresh(preferred) {
    const mine = (refreshed = fetched(preferred));
    mine.catch(() => refreshed === mine && (refreshed = null));
    return mine;
  }
  async function chosen() {
    await (refreshed ?? refresh());
    return select.value;
  }
  async function fetched(preferred) {
    maps = (await call("GET", "/maps")).maps;
    const names = maps.map((one) => one.name);
    const ready = (name) => maps.find((one) => one.name === name)?.views.ready ?? 0;
    const largest = names.reduce((best, name) => (ready(name) > ready(best) ? name : best), names[0] ?? "default");
    const first = [preferred, chosenMap()].find((name) => names.includes(name)) ?? largest;
    if (!names.includes("default")) names.push("default");
    select.replaceChildren(
      ...names.map((name) => h("option", { value: name, selected: name === first }, `${name} (${ready(name)})`)),
    );
    select.value = first;
    chooseMap(first);
    changed(facts());
    return maps;
  }
  return { select, refresh, facts, chosen };
}
