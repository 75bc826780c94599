// Loads the page again where one of its files did not arrive: the network changed, or the service began again.
// A plain script: it runs before any of the files is fetched.

const RELOADS = "revisit-reloads";
const WAITS_S = [1, 2, 4];
const missing = new Set();
const memory = (() => {
  try {
    return sessionStorage;
  } catch {
    return null; // cookies are blocked: reloads could not be counted
  }
})();

addEventListener(
  "error",
  ({ target }) => {
    if (target instanceof HTMLScriptElement) missing.add(target.src);
    if (target instanceof HTMLLinkElement) missing.add(target.href);
  },
  true, // such events do not bubble
);

// After the last file, whether it came or not; of a module that was not found the page names only main.js.
addEventListener("load", () => {
  const reloads = Number(memory?.getItem(RELOADS));
  if (missing.size === 0) {
    memory?.removeItem(RELOADS);
    return;
  }
  const names = [...missing].map((address) => new URL(address).pathname).join(", ");
  const notice = document.createElement("p");
  notice.setAttribute("role", "alert");
  document.getElementById("main").replaceChildren(notice);
  if (memory && reloads < WAITS_S.length) {
    notice.textContent = `Not all of the console arrived (${names}). It is loaded again in ${WAITS_S[reloads]} s.`;
    memory.setItem(RELOADS, String(reloads + 1));
    setTimeout(() => location.reload(), 1000 * WAITS_S[reloads]);
  } else {
    notice.textContent =
      `Not all of the console arrived (${names})${memory ? `, ${reloads + 1} times` : ""}. ` +
      "Is there a proxy between? Reload the page to try again.";
    memory?.removeItem(RELOADS);
  }
});
