// Snapshots: maps as files, made, fetched and removed, and maps made from such files.

import { address, call, key, send, upload } from "./api.js";
import { mapSelect } from "./choice.js";
import {
  MAP_NAME,
  announce,
  confirmed,
  count,
  field,
  h,
  moment,
  picker,
  problemBox,
  size,
  staying,
  table,
} from "./dom.js";
import { follow, runs } from "./jobs.js";

export function snapshotsScreen() {
  const list = h("div", { class: "table", tabindex: "0", role: "region", "aria-label": "Snapshots" });
  let left = false;

  async function load() {
    try {
      const { snapshots } = await call("GET", "/snapshots");
      const none = h("p", { class: "quiet" }, "None yet.");
      const columns = ["Map", "Made", "Views", "Size", "What to do"];
      list.replaceChildren(snapshots.length ? table(columns, snapshots.map(row)) : none);
    } catch (error) {
      list.replaceChildren(problemBox(error));
    }
  }

  function row(one) {
    const of = `the snapshot of ${one.map}, ${moment(one.created_at)}`;
    const remove = h("button", { type: "button", class: "danger", "aria-label": `Delete ${of}` }, "Delete …");
    remove.addEventListener("click", async () => {
      const text = `${count(one.views, "view")}, made ${moment(one.created_at)}. The map itself stays.`;
      if (!(await confirmed({ title: `Delete this snapshot of ${one.map}?`, text, action: "Delete the snapshot" })))
        return;
      try {
        await call("DELETE", one.links.self);
        announce("deleted");
        load();
      } catch (error) {
        list.prepend(problemBox(error));
      }
    });
    return [
      one.map,
      moment(one.created_at),
      one.views.toLocaleString("en-GB"),
      size(one.bytes),
      h("div", { class: "row" }, download(one, of), remove),
    ];
  }

  /** A link, which the browser saves as it comes; a link sends no key, so with one the file is fetched first. */
  function download(one, of) {
    const label = `Download ${of}`;
    if (!key.get())
      return h("a", { class: "button", href: one.links.self, download: true, "aria-label": label }, "Download");
    const button = h("button", { type: "button", "aria-label": label }, "Download");
    button.addEventListener("click", async () => {
      button.disabled = true;
      button.textContent = "Fetching …";
      try {
        const response = await send("GET", one.links.self);
        const [, name] = /filename="(.+)"/.exec(response.headers.get("Content-Disposition") ?? "") ?? [];
        const url = URL.createObjectURL(await response.blob());
        h("a", { href: url, download: name ?? `${one.map}.snapshot` }).click();
        setTimeout(() => URL.revokeObjectURL(url), 60_000);
      } catch (error) {
        list.prepend(problemBox(error));
      } finally {
        button.disabled = false;
        button.textContent = "Download";
      }
    });
    return button;
  }

  const maps = mapSelect();
  const make = making(maps, load, () => !left);
  return {
    element: h(
      "div",
      {},
      h("p", {}, h("a", { href: "#maps" }, "All maps")),
      h("h1", {}, "Snapshots"),
      h(
        "p",
        {},
        "A snapshot is a map as one file: views, images, descriptions and what the map learned. The restored map ",
        "gives the same answers, here or elsewhere.",
      ),
      h("section", { class: "panel" }, h("h2", {}, "Kept by this service"), list),
      h("div", { class: "columns" }, make.element, restoring(maps)),
    ),
    enter: async () => {
      left = false;
      await Promise.all([load(), maps.refresh(), make.underWay()]);
    },
    leave: () => {
      left = true;
    },
  };
}

function making(maps, made, wanted) {
  const notice = h("div", { class: "told" });
  const running = h("div", { class: "told" });
  const watched = new Set(); // ids of jobs

  async function make(event) {
    event.preventDefault();
    notice.replaceChildren();
    try {
      const name = await maps.chosen();
      watch(await call("POST", `/maps/${encodeURIComponent(name)}/snapshots`));
    } catch (error) {
      notice.replaceChildren(problemBox(error));
    }
  }

  /** Show how far the snapshot of a job is until it is made, or the screen is left. */
  async function watch(job) {
    if (watched.has(job.id)) return;
    watched.add(job.id);
    const bar = h("progress", { max: 1, "aria-label": `Progress of the snapshot of ${job.map}` });
    const line = h("p", { class: "quiet" }, `${job.map} …`);
    const element = h("div", {}, bar, line);
    const show = ({ progress }) => {
      if (!progress) return;
      bar.max = Math.max(progress.total, 1);
      bar.value = progress.done;
      line.textContent = `${job.map}: ${progress.done} of ${count(progress.total, "image")}`;
    };
    running.append(element);
    show(job);
    try {
      const ended = await follow(job, show, wanted);
      if (!wanted()) return;
      if (ended.state !== "done")
        throw Object.assign(new Error(), { title: `The job ${ended.state}`, ...ended.failure });
      notice.replaceChildren(h("p", { class: "done" }, `The snapshot of ${job.map} is made.`));
      announce(`The snapshot of ${job.map} is made.`);
      made();
    } catch (error) {
      notice.replaceChildren(problemBox(error));
    } finally {
      element.remove();
      watched.delete(job.id);
    }
  }

  /** Show the snapshots that are being made: by others, or since the screen was looked at last. */
  async function underWay() {
    const { jobs } = await call("GET", "/jobs", { query: { kind: "snapshot" } });
    jobs.filter(runs).forEach(watch);
  }

  const element = h(
    "section",
    { class: "panel" },
    h("h2", {}, "Make one"),
    h("p", {}, "In the background, while the map is used. It holds the map as it is at the beginning."),
    h(
      "form",
      { onsubmit: make },
      h("div", { class: "spaced" }, field("Map", maps.select)),
      h("button", { type: "submit", class: "first" }, "Make a snapshot"),
    ),
    running,
    notice,
  );
  return { element, underWay };
}

function restoring(maps) {
  let file = null;
  const notice = h("div", { class: "told" });
  const bar = h("progress", { value: 0, max: 1, "aria-label": "Sent of the file", hidden: true });
  const chosen = h("p", { class: "quiet" }, "No file is chosen.");
  const as = h("input", { placeholder: "as it was", ...MAP_NAME });
  const button = h("button", { type: "submit", class: "first", disabled: true }, "Restore");
  const pick = picker("Choose a snapshot file", {}, ([one]) => {
    file = one ?? null;
    chosen.textContent = file ? `${file.name}, ${size(file.size)}` : "No file is chosen.";
    button.disabled = !file;
  });

  async function restore(event) {
    event.preventDefault();
    button.disabled = true;
    bar.hidden = false;
    notice.replaceChildren();
    try {
      const path = address("/restore", { as: as.value.trim() });
      const sent = (share) => {
        bar.value = share;
        if (share === 1) notice.replaceChildren(h("p", { class: "quiet" }, "Verifying and storing it …"));
      };
      const restored = await staying(() => upload(path, file, "application/x-tar", sent));
      const link = h("a", { href: `#maps/${encodeURIComponent(restored.map)}` }, restored.map);
      const pending = restored.pending > 0 && `, ${restored.pending.toLocaleString("en-GB")} of them described anew`;
      const ids = restored.new_ids && " Its views have new ids, since one of theirs was in use.";
      const what = `: ${count(restored.views, "view")}`;
      notice.replaceChildren(h("p", { class: "done" }, "Restored as ", link, what, pending, ".", ids));
      announce(`Restored as ${restored.map}`);
      maps.refresh();
    } catch (error) {
      notice.replaceChildren(problemBox(error));
    } finally {
      button.disabled = false;
      bar.hidden = true;
    }
  }

  return h(
    "section",
    { class: "panel" },
    h("h2", {}, "Restore from a file"),
    h("p", {}, "The whole file is verified before anything is stored. Restore only files whose origin you trust."),
    h(
      "form",
      { onsubmit: restore },
      pick,
      chosen,
      h("div", { class: "spaced" }, field("Under another name", as)),
      button,
    ),
    bar,
    notice,
  );
}
