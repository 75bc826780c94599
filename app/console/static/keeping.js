// Queries that a map keeps: how many of one kind, and those that are dismissed.

import { call } from "./api.js";
import { confirmed, count, field, h, problemBox } from "./dom.js";

const SUGGESTED = 500;

/**
 * @param {{path: string, setting: string, most: number, kept: number, heading: [string, string], about: string,
 *   label: string, kind: string, tell: (text: string) => void}} what
 *   `heading` when on and when off; `kind` completes "Up to 500 queries that ... are kept".
 */
export function keeping({ path, setting, most, kept, heading, about, label, kind, tell }) {
  const wrong = h("div");
  const on = most > 0;
  const wanted = h("input", { type: "number", min: 1, max: 10_000, required: true, value: String(most || SUGGESTED) });

  async function keep(number) {
    const lost = Math.max(0, kept - number);
    const text = `The oldest ${count(lost, "query", "queries")} and the images are deleted. This cannot be undone.`;
    if (lost > 0 && !(await confirmed({ title: `Keep ${number} at most?`, text, action: "Delete them" }))) return;
    try {
      await call("PATCH", path, { json: { [setting]: number }, type: "application/merge-patch+json" });
      tell(number ? `Up to ${count(number, "query", "queries")} that ${kind} are kept.` : "Switched off.");
    } catch (error) {
      wrong.replaceChildren(problemBox(error));
    }
  }

  return h(
    "section",
    { class: "panel" },
    h("h2", {}, heading[on ? 0 : 1]),
    h("p", {}, about, " Programs send ", h("code", {}, `PATCH ${path} {"${setting}": ${most || SUGGESTED}}`), "."),
    wrong,
    h(
      "form",
      {
        class: "row",
        onsubmit: (event) => {
          event.preventDefault();
          return keep(Number(wanted.value));
        },
      },
      field(label, wanted),
      h("button", { type: "submit", class: on ? null : "first" }, on ? "Change" : "Switch on"),
      on && h("button", { type: "button", class: "danger", onclick: () => keep(0) }, "Switch off …"),
    ),
  );
}

/** Ask, then delete the kept queries at an address; `wrong` shows a problem. */
export async function dismiss({ title, number, address, wrong, tell }) {
  const text = `${count(number, "query", "queries")} and the images are deleted. This cannot be undone.`;
  if (!(await confirmed({ title, text, action: "Dismiss" }))) return;
  try {
    const { queries } = await call("DELETE", address);
    tell(`${count(queries, "query", "queries")} dismissed.`);
  } catch (error) {
    wrong.replaceChildren(problemBox(error));
  }
}
