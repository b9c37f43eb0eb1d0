// Colours of the theme in force, the theme itself, and round numbers for axes.
const NAMES = ["panel", "ink", "dim", "line", "grid", "trace", "trace2", "band", "own", "mark", "warn", "bad", "idle", "limit"];
const dark = matchMedia("(prefers-color-scheme: dark)");

export function colours() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

// What this browser remembers for this page; null where it keeps nothing.
export function kept(name) {
  try {
    return localStorage.getItem(`rigctl-${name}`);
  } catch {
    return null;
  }
}

export function keep(name, value) {
  try {
    localStorage.setItem(`rigctl-${name}`, value);
  } catch {
    // then it holds until the page is left
  }
}

export class Theme {
  constructor(button, changed) {
    this.chosen = kept("theme");
    this.button = button;
    this.changed = changed;
    button.addEventListener("click", () => this.choose(this.now === "dark" ? "light" : "dark"));
    dark.addEventListener("change", () => this.apply());
    this.apply();
  }

  get now() {
    return this.chosen ?? (dark.matches ? "dark" : "light");
  }

  choose(theme) {
    this.chosen = theme;
    keep("theme", theme);
    this.apply();
  }

  apply() {
    document.documentElement.dataset.theme = this.now;
    this.button.textContent = this.now === "dark" ? "light" : "dark";
    this.changed();
  }
}

// The next of 1, 2, 5 x 10^n.
export function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value)), share = value / power;
  return power * (share <= 1 ? 1 : share <= 2 ? 2 : share <= 5 ? 5 : 10);
}

// A canvas in the pixels of the screen; null while it has no room.
export function sized(canvas) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (!width || !height) return null;
  const w = Math.round(width * ratio), h = Math.round(height * ratio);
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, width, height);
  return { ctx, width, height };
}
