// Work in the background: what runs now, and what became of it.

import { call } from "./api.js";
import { confirmed, h, moment, problemBox, table } from "./dom.js";

const EVERY_MS = 1500;
const MOST = 20;
const KINDS = {
  describe: "describing a view",
  recipe: "describing all views anew",
  shadow: "trying another recipe in the shadow",
  vocabulary: "training a vocabulary",
  snapshot: "making a snapshot",
  import: "importing a recording",
};

const runs = (job) => ["waiting", "running"].includes(job.state);

/** Look at a job until it has ended or nobody wants to know; `told(job)` is called each time. Gives the last look. */
export async function followed(job, told, wanted = () => true) {
  let latest = job;
  for (let wait = 200; runs(latest) && wanted(); wait = Math.min(2 * wait, EVERY_MS)) {
    await new Promise((resolve) => setTimeout(resolve, wait));
    try {
      latest = await call("GET", `/jobs/${encodeURIComponent(job.id)}`);
    } catch (error) {
      if (![0, 429, 503].includes(error.status)) throw error; // a busy or restarted service goes on with its jobs
    }
    told(latest);
  }
  return latest;
}

/** The jobs of a map, or of all. `finished` is called when one that ran has ended. `stop` ends the looking. */
export function jobList(map, finished = () => {}) {
  const list = h("div", { class: "table", tabindex: "0", role: "region", "aria-label": "Jobs" });
  const element = h("div", {}, h("h2", {}, "Jobs"), list);
  let timer = null;
  let stopped = false;
  let ran = new Set();

  async function look() {
    try {
      const latest = await call("GET", "/jobs", { query: { map, limit: 100 } });
      // Views that were described are not news: there is one such job for each.
      const jobs = latest.jobs.filter((job) => job.kind !== "describe" || job.state !== "done").slice(0, MOST);
      if (stopped) return;
      const running = new Set(jobs.filter(runs).map((job) => job.id));
      const ended = [...ran].some((id) => !running.has(id));
      ran = running;
      draw(jobs);
      if (ended) finished();
      else if (running.size) timer = setTimeout(look, EVERY_MS);
    } catch (error) {
      list.replaceChildren(problemBox(error));
    }
  }

  function draw(jobs) {
    if (!jobs.length) {
      list.replaceChildren(h("p", { class: "quiet" }, "None, besides views that were described."));
      return;
    }
    const rows = jobs.map((job) => [
      KINDS[job.kind] ?? job.kind,
      [job.state, job.failure && h("div", { class: "refused" }, job.failure.detail), job.progress && progress(job)],
      moment(job.created_at),
      runs(job) &&
        h("button", { type: "button", onclick: () => cancel(job) }, "Cancel"),
    ]);
    list.replaceChildren(table(["Job", "State", "Since", ""], rows));
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
    stop: () => {
      stopped = true;
      clearTimeout(timer);
    },
  };
}
