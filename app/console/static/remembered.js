// What this tab and this browser remember. Where the browser keeps nothing (cookies are blocked), the page does.

function storage(name) {
  try {
    if (window[name]) return window[name];
  } catch {
    // blocked
  }
  const kept = new Map();
  return {
    getItem: (key) => kept.get(key) ?? null,
    setItem: (key, text) => kept.set(key, text),
    removeItem: (key) => kept.delete(key),
  };
}

export const ofTab = storage("sessionStorage");
export const ofBrowser = storage("localStorage");
