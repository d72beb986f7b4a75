// Loads the page again if one of its files does not arrive, such as from a busy machine. Imports are not attempted again by the browser.

const RELOAD_MS = 1000;

// Only elements report missing files in the capture phase; errors of scripts have the window as their target.
addEventListener("error", ({ target }) => { if (target !== window) setTimeout(() => location.reload(), RELOAD_MS); }, true);
