// Calls of the public API. The key lives in this tab's sessionStorage and goes nowhere but into the header.

const KEY = "revisit-key";
const RECENT = 20;

/** Problems that this tab was answered, newest first: {at, method, path, problem}. */
export const recentProblems = [];

export const key = {
  get: () => sessionStorage.getItem(KEY),
  headers: () => (key.get() ? { "X-Api-Key": key.get() } : {}),
  set: (text) => {
    sessionStorage.setItem(KEY, text);
    window.dispatchEvent(new Event("key"));
  },
  forget: () => {
    sessionStorage.removeItem(KEY);
    window.dispatchEvent(new Event("key"));
  },
};

/** An error of the service (RFC 9457), or that there was no answer (status 0). */
export class Problem extends Error {
  constructor(status, body, retryAfter = null) {
    super(body.detail);
    Object.assign(this, {
      status,
      title: body.title,
      detail: body.detail,
      errors: body.errors ?? [],
      requestId: body.request_id ?? null,
      retryAfter,
      code: (body.type ?? "").split(":").pop(),
    });
  }
}

/**
 * Send a request and give its Response; raises Problem.
 * options: query (object; null and "" are left out), form (FormData), json, type (of the JSON), signal,
 * quiet (a 401 opens no dialog).
 */
export async function send(
  method,
  path,
  { query = {}, form = null, json = null, type = "application/json", signal = null, quiet = false } = {},
) {
  const headers = key.headers();
  if (json !== null) headers["Content-Type"] = type;
  let response;
  try {
    response = await fetch(address(path, query), {
      method,
      headers,
      signal,
      body: form ?? (json === null ? null : JSON.stringify(json)),
      credentials: "omit",
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw remembered(
      method,
      path,
      new Problem(0, { title: "No answer", detail: "the service cannot be reached; is it running?" }),
    );
  }
  if (response.ok) return response;
  const problem = await problemOf(response);
  if (problem.status === 401 && !quiet) window.dispatchEvent(new CustomEvent("unauthorized", { detail: problem }));
  throw remembered(method, path, problem);
}

/** The JSON of an answer. */
export async function call(method, path, options = {}) {
  return (await send(method, path, options)).json();
}

/**
 * Send a file as the body and give the JSON of the answer; raises Problem. `sent` is told the share that has been sent.
 * By XMLHttpRequest, since fetch does not say how much of a body has been sent.
 */
export function upload(path, file, type, sent) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", path);
    const headers = { ...key.headers(), "Content-Type": type };
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.addEventListener("progress", (event) => sent(event.loaded / event.total));
    request.addEventListener("error", () => {
      const detail = "the service cannot be reached, or it refused the file before it had all of it; is it too large?";
      reject(remembered("POST", path, new Problem(0, { title: "No answer", detail })));
    });
    request.addEventListener("load", async () => {
      const retry = request.getResponseHeader("Retry-After");
      const response = new Response(request.responseText, {
        status: request.status,
        headers: retry ? { "Retry-After": retry } : {},
      });
      if (response.ok) {
        resolve(await response.json());
        return;
      }
      const problem = await problemOf(response);
      if (problem.status === 401) window.dispatchEvent(new CustomEvent("unauthorized", { detail: problem }));
      reject(remembered("POST", path, problem));
    });
    request.send(file);
  });
}

/** Each page of a list, one after the other. */
export async function* pages(path, query, options = {}) {
  let cursor = null;
  do {
    const page = await call("GET", path, { ...options, query: { ...query, cursor } });
    yield page;
    cursor = page.next;
  } while (cursor);
}

export function address(path, query = {}) {
  const given = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== "");
  return given.length ? `${path}?${new URLSearchParams(given)}` : path;
}

async function problemOf(response) {
  const retry = Number(response.headers.get("Retry-After")) || null;
  try {
    return new Problem(response.status, await response.json(), retry);
  } catch {
    return new Problem(
      response.status,
      { title: `Status ${response.status}`, detail: "the answer was no problem+json; is there a proxy between?" },
      retry,
    );
  }
}

function remembered(method, path, problem) {
  recentProblems.unshift({ at: new Date(), method, path, problem });
  recentProblems.length = Math.min(recentProblems.length, RECENT);
  return problem;
}
