// Compiled by a test and never run: what the types allow, and what they refuse.

import { Problem, Revisit, type QueryAnswer } from "../src/revisit.js";

const revisit = new Revisit("http://localhost:8000", { key: "rv_1" });

export async function allowed(photo: Blob): Promise<string | null> {
  const answer: QueryAnswer = await revisit.query(photo, { maps: "floor1,floor2", top: 3, "metadata.run": "7" });
  const status: "matched" | "ambiguous" | "no_match" = answer.status;
  const given = { map: "campus", place: "gate", x: 1.5, y: 2 };
  const enrolled = await revisit.enroll(photo, given, { idempotencyKey: "keyframe-7", signal: AbortSignal.timeout(9000) });
  await revisit.query(photo, { drive: "monday" }, { idempotencyKey: null, signal: null });
  await revisit.post("/enroll", { query: given, body: photo, idempotencyKey: "keyframe-8" });
  const facts = await revisit.get("/maps/{map}", { path: { map: "campus" } });
  const view = await revisit.patch("/views/{view_id}", { path: { view_id: enrolled.view.id }, json: { place: null } });
  const page = await revisit.get("/views", { query: { map: "campus", limit: 10 } });
  const gone: number = (await revisit.delete("/views", { query: { map: "campus", all: true } })).views;
  return status === "matched" && gone > facts.revision ? (page.next ?? view.place) : null;
}

export async function refused(photo: Blob): Promise<void> {
  // @ts-expect-error: there is no such parameter
  await revisit.query(photo, { journey: "monday" });
  // @ts-expect-error: a number is needed
  await revisit.query(photo, { top: "3" });
  // @ts-expect-error: there is no such path
  await revisit.get("/view");
  // @ts-expect-error: the path has no such method
  await revisit.put("/query", {});
  // @ts-expect-error: the path needs the name of a map
  await revisit.delete("/maps/{map}", {});
  // @ts-expect-error: this call is not done once
  await revisit.post("/maps/{map}/snapshots", { path: { map: "campus" }, idempotencyKey: "friday" });
  // @ts-expect-error: parameters are not told twice
  await revisit.query(photo, {}, { query: { map: "campus" } });
  // @ts-expect-error: an answer has no such field
  (await revisit.query(photo)).distance;
}

export function told(error: unknown): string {
  return error instanceof Problem ? `${error.code}: ${error.detail} (${error.requestId})` : String(error);
}
