// The receipt of a deletion: what is gone from where, and which snapshots still have it.

import { call } from "./api.js";
import { confirmed, count, facts, h, moment, problemBox } from "./dom.js";

/** Show a receipt in a dialog; resolves when it is closed. */
export function showReceipt(title, receipt) {
  return new Promise((resolve) => {
    const dialog = h(
      "dialog",
      { class: "small receipt", "aria-labelledby": "receipt-title" },
      h("h2", { id: "receipt-title" }, title),
      h("p", {}, "Gone for good:"),
      facts(
        [
          ["Views", count(receipt.views, "view")],
          ["Descriptions", receipt.descriptions && count(receipt.descriptions, "description")],
          ["From the index", receipt.searched && count(receipt.searched, "view")],
          ["Images", receipt.images && count(receipt.images, "file")],
          ["Kept queries", receipt.queries && count(receipt.queries, "query", "queries")],
          ["Scores", receipt.scores && `of ${count(receipt.scores, "day")}`],
        ].map(([name, value]) => [name, value || null]),
      ),
      left(receipt),
      h(
        "div",
        { class: "row" },
        h("button", { type: "button", class: "first", onclick: () => dialog.close() }, "Close"),
      ),
    );
    dialog.addEventListener("close", () => {
      dialog.remove();
      resolve();
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}

function left(receipt) {
  const { snapshots, snapshots_of_others: hidden, images_shared: shared } = receipt;
  if (!snapshots.length && !hidden && !shared)
    return h(
      "p",
      {},
      "Nothing of it is left here: no snapshot and no other view has it. Downloads and backups are not known.",
    );
  return h(
    "div",
    { class: "problem" },
    h("h3", {}, "Not gone"),
    shared > 0 && h("p", {}, `${count(shared, "image")} that other views have too.`),
    snapshots.length > 0 && h("p", {}, "Snapshots that were made before still have it:"),
    h("ul", { class: "holdings" }, snapshots.map(holding)),
    hidden > 0 && h("p", {}, `${count(hidden, "snapshot")} of maps that this key does not allow.`),
  );
}

function holding(one) {
  const wrong = h("div");
  const of = one.map === null ? "one that was being made" : `${one.map}, ${moment(one.created_at) ?? "time unknown"}`;
  const has = one.views === null ? "it may have some of it" : `has ${count(one.views, "view")} of it`;
  const remove = h(
    "button",
    { type: "button", class: "danger", "aria-label": `Delete the snapshot of ${of}` },
    "Delete …",
  );
  remove.addEventListener("click", async () => {
    const text = "The whole snapshot is deleted, and cannot be restored from.";
    if (!(await confirmed({ title: "Delete this snapshot?", text, action: "Delete the snapshot" }))) return;
    try {
      await call("DELETE", `/snapshots/${encodeURIComponent(one.id)}`);
      item.replaceChildren(h("span", {}, `${of}: deleted`));
    } catch (error) {
      wrong.replaceChildren(problemBox(error));
    }
  });
  const item = h("li", { class: "row between" }, h("span", {}, `${of}: ${has}`), remove, wrong);
  return item;
}
