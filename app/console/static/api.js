// Calls of the public API, by its client. The key is kept in this tab's sessionStorage, and sent in the header alone.

import { ofTab } from "./remembered.js";
import { Problem, Revisit, address } from "./revisit.js";

export { Problem, address };

const KEY = "revisit-key";
const RECENT = 20;
const AGAIN_MS = 300;

/** Problems that calls of this tab were answered with, newest first: {at, method, path, problem}. */
export const recentProblems = [];

export const key = {
  get: () => ofTab.getItem(KEY),
  set: (text) => {
    ofTab.setItem(KEY, text);
    window.dispatchEvent(new Event("key"));
  },
  forget: () => {
    ofTab.removeItem(KEY);
    window.dispatchEvent(new Event("key"));
  },
};

/**
 * fetch with the password that a proxy asked for when the page was loaded. Addresses are absolute: where the page's own
 * has a password in it (name:password@host), fetch refuses relative ones.
 */
export const fetched = (path, options) => fetch(location.origin + path, { ...options, credentials: "same-origin" });

export const service = new Revisit("", { key: key.get, fetch: fetched });

/**
 * Send a request and give its Response; raises Problem.
 * options: query (object; null and "" are left out), form (FormData), json, type (of the JSON), signal,
 * quiet (a 401 opens no dialog). A GET without an answer is sent once more: browsers drop requests when their machine
 * changes networks.
 */
export async function send(method, path, { form = null, quiet = false, ...options } = {}) {
  const once = () => service.send(method, path, { ...options, body: form });
  try {
    return await once().catch(async (error) => {
      if (method !== "GET" || !(error instanceof Problem) || error.status !== 0) throw error;
      await new Promise((done) => setTimeout(done, AGAIN_MS));
      return once();
    });
  } catch (error) {
    if (!(error instanceof Problem)) throw error;
    throw remember(method, path, error, quiet);
  }
}

/** The JSON of an answer; raises Problem. */
export async function call(method, path, options = {}) {
  return parsed(method, path, await send(method, path, options));
}

async function parsed(method, path, response) {
  try {
    return await response.json();
  } catch {
    const detail = "the answer broke off, or is not of revisit; is there a proxy between?";
    throw remember(method, path, Problem.silence(detail));
  }
}

/**
 * Send a file as the body and give the JSON of the answer; raises Problem. `progress` is called with the share that has
 * been sent, 0 to 1. It uses XMLHttpRequest, since fetch does not say how much of a body has been sent.
 */
export function upload(path, file, type, progress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", path);
    const headers = { ...service.headers(), "Content-Type": type };
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.addEventListener("progress", (event) => progress(event.loaded / event.total));
    request.addEventListener("error", () => {
      const detail = "the service cannot be reached, or it refused the file before it had all of it; is it too large?";
      reject(remember("POST", path, Problem.silence(detail)));
    });
    request.addEventListener("load", async () => {
      const retry = request.getResponseHeader("Retry-After");
      const response = new Response(request.responseText, {
        status: request.status,
        headers: retry ? { "Retry-After": retry } : {},
      });
      if (response.ok) {
        resolve(parsed("POST", path, response));
        return;
      }
      reject(remember("POST", path, await Problem.of(response)));
    });
    request.send(file);
  });
}

/**
 * Pages of a list: `next()` gives {value}, after the last page {done: true}. After an error it asks for the same page
 * again. `resume()`, after the last page, has that page asked for again, and pages that have been added since.
 */
export function pages(path, query, options = {}) {
  let cursor = null;
  let last = null; // the cursor of the page that came last
  let done = false;
  return {
    async next() {
      if (done) return { done };
      const value = await call("GET", path, { ...options, query: { ...query, cursor } });
      last = cursor;
      cursor = value.next;
      done = !cursor;
      return { value };
    },
    resume() {
      if (!done) return;
      cursor = last;
      done = false;
    },
  };
}

function remember(method, path, problem, quiet = false) {
  if (problem.status === 401 && !quiet) window.dispatchEvent(new CustomEvent("unauthorized", { detail: problem }));
  // Paths that are read again and again, such as /metrics, would leave no room for other problems.
  const again = recentProblems.findIndex(
    (one) => method === "GET" && one.method === method && one.path === path && one.problem.code === problem.code,
  );
  if (again >= 0) recentProblems.splice(again, 1);
  recentProblems.unshift({ at: new Date(), method, path, problem });
  recentProblems.length = Math.min(recentProblems.length, RECENT);
  return problem;
}
