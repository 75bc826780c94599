// An answer in words and pictures.

import { whatChanged } from "./changes.js";
import { bars, count, decimals, facts, folded, h, percent, place as inWords, sentence } from "./dom.js";
import { drawing, image } from "./images.js";
import { differences, pairs } from "./pairs.js";
import { plan, surroundings } from "./plan.js";
import { drivePanel, probabilities } from "./probabilities.js";

const TITLES = {
  matched: (name) => ["This is ", h("strong", {}, name)],
  ambiguous: (name) => ["Perhaps ", h("strong", {}, name), ", but not sure"],
  no_match: () => ["Not recognised"],
};

const TERMS = {
  "histogram.semantic": "semantic words",
  "histogram.detail": "detail words",
  dense: "cells",
  dense_full: "cells in full",
  graph: "graph",
  verification: "geometry",
};

const nameOf = (view) => view.place ?? `view ${view.id.slice(-6)}`;

/** The elements that show an answer: `short`, and `long` to go below. `photo`: URL of the query's image here. */
export function answerPanel(answer, photo) {
  const [first] = answer.matches;
  const detail = h("div");
  const cards = answer.matches.map((match) => matchCard(match, answer.maps, () => show(match)));
  function show(match) {
    cards.forEach((card, index) => {
      const chosen = answer.matches[index] === match;
      card.classList.toggle("chosen", chosen);
      card.querySelector("button").setAttribute("aria-pressed", chosen);
    });
    detail.replaceChildren(evidence(answer, match, photo));
  }
  if (first) show(first);
  const panel = (title, ...content) => h("section", { class: "panel" }, title && h("h2", {}, title), content);
  return {
    short: [
      verdict(answer),
      answer.drive && drivePanel(answer.drive),
      answer.places.length > 0 && panel("Places", probabilities(answer), planOf(answer)),
    ].filter(Boolean),
    long: [
      first && panel("Views that look like it", h("ol", { class: "matches" }, cards)),
      first && panel(null, detail),
      answer.status !== "no_match" &&
        first?.links.explanation &&
        panel("Since it was enrolled", changesOf(answer, first)),
      panel("How it went", timesOf(answer), decisionOf(answer)),
    ].filter(Boolean),
  };
}

function verdict(answer) {
  const [best] = answer.places;
  const known = best ? (best.place ?? nameOf(answer.matches[0].view)) : "";
  const name = answer.maps ? `${known} of ${answer.map}` : known;
  return h(
    "section",
    { class: `panel verdict ${answer.status}` },
    h("h2", {}, TITLES[answer.status](name)),
    h(
      "p",
      {},
      `${sentence(answer.reason.detail)} `,
      answer.status === "matched" ? null : sentence(answer.reason.remedy),
    ),
    h(
      "p",
      { class: "quiet" },
      `Probability ${percent(answer.confidence)}; sure from ${percent(answer.decision.threshold)} on, `,
      `so that ${percent(answer.decision.precision)} of such answers are right. `,
      `${count(answer.searched, "view")} searched`,
      `${answer.pending ? `, ${answer.pending} more not described yet` : ""}.`,
    ),
    answer.maps &&
      facts(
        answer.maps.map((one) => [
          `The map ${one.map}`,
          `probability ${percent(one.probability)}, ${count(one.searched, "view")}`,
        ]),
      ),
  );
}

/** A plan of the matched views and of the estimated position; null where neither has a position. */
function planOf(answer) {
  const points = answer.matches
    .filter((match) => match.view.position && match.view.map === answer.map) // other maps have frames of their own
    .map((match) => ({
      position: match.view.position,
      kind: match.rank === 1 ? "first" : "match",
      name: `${match.rank}. ${nameOf(match.view)}`,
    }));
  if (!answer.estimate && points.length === 0) return null;
  const estimate = answer.estimate;
  const picture = plan(points, { circle: estimate && { position: estimate.position, radius: estimate.radius_m } });
  const known = new Set(answer.matches.map((match) => match.view.id));
  const positions = points.map((point) => point.position);
  surroundings(answer.map, estimate ? [estimate.position, ...positions] : positions).then(
    (others) => picture.add(others.filter((point) => !known.has(point.id))),
    () => {}, // without the other views the plan still shows the matches
  );
  return h(
    "div",
    {},
    estimate &&
      h(
        "p",
        {},
        "Taken about ",
        h("strong", {}, inWords(estimate.position)),
        estimate.radius_m === null ? "." : `, give or take ${decimals(estimate.radius_m, 1)} m.`,
      ),
    picture.element,
  );
}

function matchCard(match, several, choose) {
  const name = several ? `${nameOf(match.view)} of ${match.view.map}` : nameOf(match.view);
  return h(
    "li",
    { class: "match" },
    image(match.links.thumbnail, `Match ${match.rank}: ${name}`, { width: 256, height: 192 }),
    h("h3", {}, `${match.rank}. ${name}`),
    h("p", { class: "quiet" }, `score ${decimals(match.score)}, probability ${percent(match.confidence)}`),
    bars(
      Object.entries(match.parts).map(([term, value]) => [TERMS[term] ?? term, value]),
      { text: decimals, className: "bars parts" },
    ),
    h(
      "button",
      {
        type: "button",
        "aria-pressed": "false",
        onclick: choose,
        "aria-label": `Compare with ${match.rank}. ${name}`,
      },
      "Compare",
    ),
  );
}

/** What speaks for a match: what agrees, drawings, and where the rival differs. */
function evidence(answer, match, photo) {
  const { view } = match;
  const rival = match.rank === 1 ? answer.reason.rival : null;
  return h(
    "div",
    {},
    h("h2", {}, `Your photo and ${match.rank}. ${nameOf(view)}`),
    facts([
      ["Position", inWords(view.position)],
      [
        "Regions that agree",
        match.graph && `${match.graph.correspondences} of ${match.graph.nodes_query} and ${match.graph.nodes_view}`,
      ],
      ["Keypoints that agree", match.verification && `${match.verification.inliers} of ${match.verification.matches}`],
      [
        "Cells that agree",
        match.dense &&
          `${decimals(match.dense.similarity)}; a wrong view gets ${decimals(match.dense.median_similarity)}`,
      ],
    ]),
    pairs(answer.query, match, photo),
    rival &&
      h(
        "div",
        {},
        h("h3", {}, `The rival: ${nameOf(rival.view)}${answer.maps ? ` of ${rival.view.map}` : ""}`),
        h("p", {}, `It scores ${decimals(rival.score)}, the first ${decimals(match.score)}.`),
        differences(answer.query, rival, photo),
      ),
    match.links.explanation &&
      folded("Everything in one picture, drawn by the service", () =>
        drawing(
          match.links.explanation,
          "Explanation of the answer",
          "Cells, keypoints and regions that agree, the parts of the score, and a rival.",
        ),
      ),
    folded("What the service sees in the view", () =>
      h(
        "div",
        { class: "columns" },
        drawing(
          `${view.links.segmentation}?overlay=true&legend=true`,
          "Labels of the view",
          "Labels; what moves is grey.",
        ),
        drawing(`${view.links.graph}?legend=true`, "Context graph of the view", "Regions and which of them touch."),
      ),
    ),
    answer.query.labels.length > 0 &&
      folded("What it sees in your photo", () =>
        bars(answer.query.labels.slice(0, 12).map((one) => [one.label, one.share])),
      ),
  );
}

/** What changed since the first view was taken; asks while the service keeps the photo of the query. */
function changesOf(answer, first) {
  const address = `/queries/${encodeURIComponent(answer.query.id)}/changes`;
  return [
    h("p", {}, `What is gone, new or moved at ${nameOf(first.view)} since its photo was taken?`),
    whatChanged("What changed here?", () => address).element,
  ];
}

const duration = (ms) =>
  ms < 1000 ? `${ms < 10 ? ms.toFixed(1) : Math.round(ms)} ms` : `${(ms / 1000).toFixed(1)} s`;

/** How long each stage of the query took. */
function timesOf(answer) {
  const { total, ...stages } = answer.timing_ms;
  const longest = Math.max(1, ...Object.values(stages));
  return h(
    "div",
    {},
    h("p", {}, total === undefined ? null : `${duration(total)} in all.`),
    bars(Object.entries(stages), { of: longest, text: duration }),
  );
}

/** The figures that the verdict rests on, unfolded on demand. */
function decisionOf(answer) {
  const { decision } = answer;
  return h(
    "details",
    {},
    h("summary", {}, "What the verdict was made from"),
    facts([
      ...Object.entries(decision.features).map(([name, value]) => [name, decimals(value, 3)]),
      ["What wrong answers score here", decimals(decision.wrong_score, 3)],
      ["By how much they lead", decimals(decision.wrong_gap, 3)],
      ["Measured with", count(decision.views_compared, "view")],
      ["Query", answer.query.id],
      ["Map and revision", `${answer.map}, ${answer.revision}`],
      ["Recipe", answer.recipe],
      ["Ranking", answer.ranking],
    ]),
  );
}
