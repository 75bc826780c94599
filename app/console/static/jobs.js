// Work in the background: what runs now, and what became of it.

import { call } from "./api.js";
import { confirmed, h, moment, problemBox, showProblem, table } from "./dom.js";

const EVERY_MS = 1500;
const AGAIN_MS = 5000; // after a refusal
const IDLE_MS = 10_000;
const PASSING = [0, 429, 503]; // a busy or restarting service goes on with its jobs
const MOST = 20;
const KINDS = {
  describe: "describing a view",
  recipe: "describing all views anew",
  shadow: "trying another recipe in the shadow",
  vocabulary: "training a vocabulary",
  snapshot: "making a snapshot",
  import: "importing a recording",
};

const OF_MAPS = Object.keys(KINDS)
  .filter((kind) => kind !== "describe")
  .join();

export const runs = (job) => ["waiting", "running"].includes(job.state);

/** Poll a job until it has ended or `wanted()` is false; `report(job)` is called each time. Gives its last state. */
export async function follow(job, report, wanted = () => true) {
  let latest = job;
  for (let wait = 200; runs(latest) && wanted(); wait = Math.min(2 * wait, EVERY_MS)) {
    await new Promise((resolve) => setTimeout(resolve, wait));
    try {
      latest = await call("GET", `/jobs/${encodeURIComponent(job.id)}`);
    } catch (error) {
      if (!PASSING.includes(error.status)) throw error;
    }
    report(latest);
  }
  return latest;
}

/**
 * Look every few seconds, while the page is seen, at what others may change. `refused` is called with a problem that
 * ends it, such as a key that ended. Gives a function that ends it.
 */
export function lookAgain(look, refused) {
  let timer = setTimeout(again, IDLE_MS);
  async function again() {
    try {
      if (!document.hidden) await look();
    } catch (error) {
      if (!PASSING.includes(error.status)) {
        refused(error);
        return;
      }
    }
    if (timer !== null) timer = setTimeout(again, IDLE_MS);
  }
  return () => {
    clearTimeout(timer);
    timer = null;
  };
}

/**
 * The jobs of a map, or of all maps, polled while one runs. `finished` is called when a job has ended; for jobs that
 * describe views, when the last of them has. While none runs they are polled every `idle` milliseconds, or not until
 * `look` is called where that is null. `stop` ends the polling.
 */
export function jobList(map, finished = () => {}, idle = null) {
  const list = h("div", { class: "table", tabindex: "0", role: "region", "aria-label": "Jobs" });
  const element = h("div", {}, h("h2", {}, "Jobs"), list);
  let timer = null;
  let stopped = false;
  let ran = new Set();

  async function look() {
    clearTimeout(timer);
    try {
      // Each view has a job of its own, those of an import too: among them the others would not be found.
      const [ofMaps, ofViews] = await Promise.all([
        call("GET", "/jobs", { query: { map, kind: OF_MAPS, limit: MOST / 2 } }),
        call("GET", "/jobs", { query: { map, kind: "describe", limit: 100 } }),
      ]);
      if (stopped) return;
      const latest = [...ofMaps.jobs, ...ofViews.jobs];
      const jobs = latest.filter((job) => job.kind !== "describe" || job.state !== "done").slice(0, MOST);
      const running = new Set(latest.filter(runs).map((job) => job.id));
      const news = ofMaps.jobs.some((job) => ran.has(job.id) && !runs(job));
      const ended = news || (ran.size > 0 && running.size === 0);
      ran = running;
      draw(jobs);
      if (running.size || idle) timer = setTimeout(look, running.size ? EVERY_MS : idle);
      if (ended) finished();
    } catch (error) {
      if (stopped) return;
      showProblem(list, error);
      if (PASSING.includes(error.status)) timer = setTimeout(look, AGAIN_MS);
    }
  }

  function draw(jobs) {
    if (!jobs.length) {
      list.replaceChildren(h("p", { class: "quiet" }, "None, besides views that were described."));
      return;
    }
    const focused = list.contains(document.activeElement) && document.activeElement.dataset.job;
    const rows = jobs.map((job) => [
      KINDS[job.kind] ?? job.kind,
      [job.state, job.failure && h("div", { class: "refused" }, job.failure.detail), job.progress && progress(job)],
      moment(job.created_at),
      runs(job) &&
        h("button", { type: "button", "data-job": job.id, onclick: () => cancel(job) }, "Cancel"),
    ]);
    list.replaceChildren(table(["Job", "State", "Since", ""], rows));
    if (focused) list.querySelector(`[data-job="${CSS.escape(focused)}"]`)?.focus();
  }

  function progress({ kind, state, progress: { done, total } }) {
    return h(
      "div",
      {},
      state === "running" &&
        h("progress", { value: done, max: Math.max(total, 1), "aria-label": `Progress of ${KINDS[kind] ?? kind}` }),
      h("span", { class: "quiet" }, `${done} of ${total} images`),
    );
  }

  async function cancel(job) {
    if (!(await confirmed({ title: "Cancel this job?", text: `It is ${job.state}.`, action: "Cancel the job" })))
      return;
    try {
      await call("DELETE", `/jobs/${job.id}`);
      look();
    } catch (error) {
      list.prepend(problemBox(error));
    }
  }

  look();
  return {
    element,
    look,
    stop: () => {
      stopped = true;
      clearTimeout(timer);
    },
  };
}
