// The service: whether it is well, what is loaded, its queue, its figures, and the problems of this tab.

import { Problem, call, fetched, recentProblems, send, service } from "./api.js";
import { count, facts, h, showProblem, size } from "./dom.js";
import { jobList } from "./jobs.js";
import { part } from "./parts.js";

const EVERY_MS = 5000;

export function serviceScreen() {
  const parts = Object.fromEntries(["checks", "loaded", "figures"].map((name) => [name, h("div")]));
  // These are looked at longer, unfolded and copied from: they are drawn anew where they have changed.
  const version = part((version) => version, loaded);
  const recent = part((list) => list, problems);
  const jobs = jobList(null, undefined, EVERY_MS);
  let timer = null;
  let left = false;

  async function look() {
    await Promise.all([
      shown(parts.checks, checks),
      shown(parts.figures, figures),
      shown(parts.loaded, async () => {
        version.show(await call("GET", "/version"));
        return version.element;
      }),
    ]);
    recent.show([...recentProblems]);
    if (!left) timer = setTimeout(look, EVERY_MS);
  }

  return {
    element: h(
      "div",
      {},
      h("h1", {}, "Service"),
      h(
        "div",
        { class: "columns" },
        panel("Is it well?", parts.checks),
        panel("What is loaded", parts.loaded),
        panel("Figures since it started", parts.figures),
        panel("Problems in this tab", recent.element),
      ),
      h("section", { class: "panel" }, jobs.element),
      panel(
        "Keys",
        h(
          "p",
          {},
          "Keys are made and revoked where the service runs: ",
          h("code", {}, "./revisit keys create NAME --scope read"),
          ", ",
          h("code", {}, "./revisit keys list"),
          ", ",
          h("code", {}, "./revisit keys revoke NAME"),
          ".",
        ),
      ),
    ),
    enter: look,
    leave: () => {
      left = true;
      clearTimeout(timer);
      jobs.stop();
    },
  };
}

const panel = (title, ...content) => h("section", { class: "panel" }, h("h2", {}, title), content);

async function shown(element, make) {
  try {
    const made = await make();
    if (element.firstChild !== made) element.replaceChildren(made);
  } catch (error) {
    showProblem(element, error);
  }
}

/** What the service says of itself, which has all parts with a 503 too; raises Problem for any other answer. */
async function readiness() {
  const response = await fetched("/readyz", { headers: service.headers() }).catch(() => {
    throw Problem.silence();
  });
  const checked = await response
    .clone()
    .json()
    .catch(() => null);
  if (!checked?.checks) throw await Problem.of(response);
  return checked;
}

async function checks() {
  const { ready, checks: states, maps, age_s } = await readiness();
  const behind = Object.entries(maps).filter(([, one]) => one.state !== "ok");
  return h(
    "div",
    {},
    h(
      "p",
      {},
      h("strong", { class: ready ? "state-ok" : "state-bad" }, ready ? "Ready" : "Not ready"),
      h("span", { class: "quiet" }, ` (checked ${Math.round(age_s)} s ago)`),
    ),
    facts(
      [...Object.entries(states), ...behind.map(([name, one]) => [`map ${name}`, one.state])].map(([name, state]) => [
        name,
        h("span", { class: state === "ok" ? "state-ok" : "state-bad" }, state),
      ]),
    ),
  );
}

function loaded({ libraries, ...version }) {
  return h(
    "div",
    {},
    facts(Object.entries(version)),
    h("details", {}, h("summary", {}, "Libraries"), facts(Object.entries(libraries))),
  );
}

async function figures() {
  const series = samples(await (await send("GET", "/metrics", { quiet: true })).text());
  const sum = (name, labels = {}) =>
    series
      .filter((one) => one.name === name && Object.entries(labels).every(([key, value]) => one.labels[key] === value))
      .reduce((total, one) => total + one.value, 0);
  const mean = (route) => {
    const [number, seconds] = ["count", "sum"].map((of) =>
      sum(`revisit_http_request_duration_seconds_${of}`, { route }),
    );
    return number ? `${Math.round((seconds / number) * 1000)} ms on average of ${count(number, "request")}` : null;
  };
  const verdicts = series.filter((one) => one.name === "revisit_query_verdicts_total" && one.value > 0);
  return facts([
    ["Requests", sum("revisit_http_requests_total").toLocaleString("en-GB")],
    ["POST /query", mean("/query")],
    ["POST /enroll", mean("/enroll")],
    ["Verdicts", verdicts.map((one) => `${one.value} ${one.labels.status} (${one.labels.reason})`).join(", ")],
    ["Jobs waiting", sum("revisit_jobs", { state: "waiting" })],
    ["Jobs running", sum("revisit_jobs", { state: "running" })],
    ["Problems answered", sum("revisit_http_problems_total")],
    ["Memory", size(sum("process_resident_memory_bytes"))],
  ]);
}

/** The samples of Prometheus's text format: {name, labels, value}. */
function samples(text) {
  return text.split("\n").flatMap((line) => {
    const found = /^([a-zA-Z_:][\w:]*)(?:\{(.*)\})? (\S+)$/.exec(line);
    if (!found) return [];
    const labels = Object.fromEntries(
      [...(found[2] ?? "").matchAll(/(\w+)="((?:[^"\\]|\\.)*)"/g)].map(([, name, value]) => [name, value]),
    );
    return [{ name: found[1], labels, value: Number(found[3]) }];
  });
}

function problems() {
  if (!recentProblems.length) return h("p", { class: "quiet" }, "None.");
  return h(
    "ul",
    {},
    recentProblems.map(({ at, method, path, problem }) =>
      h(
        "li",
        {},
        `${at.toLocaleTimeString("en-GB")} ${method} ${path}: `,
        `${problem.status || ""} ${problem.title}. ${problem.detail ?? ""}`,
        problem.requestId && h("span", { class: "quiet" }, " request ", h("code", {}, problem.requestId)),
      ),
    ),
  );
}
