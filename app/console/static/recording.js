// Recordings: zip archives of images, or videos, each enrolled as one job; its progress, and what was wrong with it.

import { address, call, upload } from "./api.js";
import { announce, confirmed, count, facts, field, h, picker, problemBox, size, staying, table } from "./dom.js";
import { follow } from "./jobs.js";

const UNFOLDED = 20; // errors of a kind that are shown at once
export const RECORDINGS = /\.(zip|mp4|m4v|mov|mkv|webm|avi|mcap)$/i;
const KINDS = {
  "bad-row": "The row of the manifest cannot be used",
  "no-row": "Without a row in the manifest; enrolled without attributes",
  "no-file": "Rows without a file",
  "no-image": "Neither image nor manifest",
  conflict: "In the map already, with other attributes",
};

/**
 * A panel that imports recordings into the map whose name `map()` promises; `changed` is called when one has ended.
 * Gives {element, take(files)}.
 */
export function recording(map, changed) {
  let chosen = []; // {file, status, result, element, done}
  let job = null;
  let busy = false;
  const bar = h("progress", { value: 0, max: 1, "aria-label": "Progress of the recording", hidden: true });
  const list = h("div", { class: "told" }, h("p", { class: "quiet" }, "None is chosen."));
  const wrong = h("div");
  const every = h("input", { size: 6, placeholder: "all", spellcheck: "false", autocomplete: "off" });
  const start = h("button", { type: "submit", class: "first", disabled: true }, "Import the recording");
  const stop = h("button", { type: "button", class: "danger", hidden: true, onclick: cancel }, "Cancel …");

  /** Take files, to be imported one after another in place of those that were chosen before. */
  function take(files) {
    wrong.replaceChildren();
    if (busy) {
      const names = files.map((file) => file.name).join(", ");
      const detail = `${names}: recordings are being imported; choose it again after them`;
      wrong.append(problemBox({ title: "Not taken", detail }));
      return;
    }
    chosen = files.map(entry);
    list.replaceChildren(...chosen.map((one) => one.element));
    start.textContent = files.length > 1 ? `Import ${files.length} recordings` : "Import the recording";
    start.disabled = false;
  }

  function entry(file) {
    const status = h("p", { class: "quiet" }, size(file.size));
    const result = h("div");
    return { file, status, result, element: h("div", {}, h("h3", {}, file.name), status, result), done: false };
  }

  async function run(event) {
    event.preventDefault();
    busy = true;
    start.disabled = true;
    bar.hidden = false;
    wrong.replaceChildren();
    const left = chosen.filter((one) => !one.done);
    const queue = left.length ? left : chosen;
    try {
      const name = await map();
      for (const one of queue) {
        const importing = () => imported(one, name);
        const goesOn = one === queue.at(-1) ? importing() : staying(importing); // the next one is still to be sent
        if (!(await goesOn)) break;
      }
    } catch (error) {
      wrong.replaceChildren(problemBox(error));
    } finally {
      busy = false;
      start.disabled = false;
      bar.hidden = true;
    }
  }

  /** Import one into a map; whether the next one is to follow. */
  async function imported(one, name) {
    const { file, status, result } = one;
    const path = address(`/maps/${encodeURIComponent(name)}/imports`, { every: every.value.trim() });
    const sent = (share) => {
      bar.max = 1;
      bar.value = share;
      status.textContent = share < 1 ? `${size(share * file.size)} of ${size(file.size)} sent` : "Reading it …";
    };
    job = null;
    result.replaceChildren();
    try {
      job = await staying(() => upload(path, file, "application/octet-stream", sent));
      stop.hidden = false;
      job = await follow(job, (latest) => show(one, latest));
      const ended = { done: "Done", cancelled: "Cancelled; what was enrolled stays", failed: "Failed" }[job.state];
      status.textContent = `${ended}: ${name}.`;
      if (job.state === "failed") result.prepend(problemBox({ title: "The job failed", ...job.failure }));
      one.done = job.state === "done";
      announce(`${file.name}. ${status.textContent}`);
      changed();
      return job.state !== "cancelled";
    } catch (error) {
      status.textContent = job
        ? `${file.name} was sent; the jobs of the map tell how its import goes on.`
        : `${file.name} was not imported.`;
      result.replaceChildren(problemBox(error));
      return error.status !== 401; // which the others would get as well
    } finally {
      stop.hidden = true;
    }
  }

  function show({ status, result }, { progress, result: report }) {
    if (progress) {
      bar.max = Math.max(progress.total, 1);
      bar.value = progress.done;
      status.textContent = `${progress.done.toLocaleString("en-GB")} of ${count(progress.total, "image")}`;
    }
    if (report) result.replaceChildren(reportSummary(report));
  }

  async function cancel() {
    const text = "What was enrolled stays. Sending the recording again continues.";
    if (!(await confirmed({ title: "Cancel this import?", text, action: "Cancel the import" }))) return;
    try {
      await call("DELETE", `/jobs/${encodeURIComponent(job.id)}`);
    } catch (error) {
      wrong.replaceChildren(problemBox(error));
    }
  }

  const kinds = { accept: ".zip,.mkv,.mcap,video/*", multiple: true };
  const pick = picker("Choose a zip archive or a video", kinds, take);
  const element = h(
    "section",
    { class: "panel", "aria-label": "A recording" },
    h("h2", {}, "A recording"),
    h(
      "p",
      {},
      "A zip archive of images, into the map chosen above, with a manifest.csv or without: file, place, x, y ",
      "or lat, lon, heading, captured_at; any other column is kept as metadata. Or a video, or MCAP of ROS 2.",
    ),
    h(
      "p",
      { class: "quiet" },
      "Several are imported in turn. Every 2s, 1min or 1m (metres) leaves out what was taken sooner or nearer; of a ",
      "video, one frame a second is taken otherwise.",
    ),
    h(
      "form",
      { onsubmit: run },
      h("div", { class: "row low" }, pick, field("Every", every), start, stop),
    ),
    bar,
    wrong,
    list,
  );
  return { element, take };
}

/** What came of a recording: counts, and the errors of each kind. */
function reportSummary(report) {
  const kinds = new Map();
  for (const one of report.errors ?? []) kinds.set(one.problem, [...(kinds.get(one.problem) ?? []), one]);
  return h(
    "div",
    {},
    facts([
      ["Images", report.images],
      ["Enrolled", report.enrolled],
      ["There already", report.already_there],
      ["Failed", report.failed],
      ...(report.poor ? [["Dark, overexposed, covered or blurred", report.poor]] : []),
      ...(report.left_out ? [["Left out", report.left_out]] : []),
    ]),
    [...kinds].map(([problem, errors]) => {
      const title = KINDS[problem] ?? problem[0].toUpperCase() + problem.slice(1).replaceAll("-", " ");
      return h(
        "details",
        { open: errors.length <= UNFOLDED },
        h("summary", {}, `${title}: ${errors.length}`),
        h(
          "div",
          { class: "table tall", tabindex: "0", role: "region", "aria-label": title },
          table(["File", "Why"], errors.map((one) => [one.file, one.detail])),
        ),
      );
    }),
    report.errors_left_off > 0 && h("p", { class: "quiet" }, `${report.errors_left_off} more errors are not listed.`),
  );
}
