// Buckets of the window shown: smallest and largest value of every signal, in rings. See rigctl/page/chart_frame.py.
const HEADER_BYTES = 32;
const BUCKETS = 1200;

export class Store {
  constructor() {
    this.clear();
    this.frames = 0;
  }

  clear() {
    this.newest = -1; // number of the newest bucket
    this.window = -1;
    this.widthMs = 0;
    this.newestMs = 0; // wall clock of the newest record
    this.low = [];
    this.high = [];
    this.offset = null; // wall clock less performance.now(), smoothed: the charts glide though data come in batches
  }

  take(buffer, now) {
    const head = new DataView(buffer, 0, HEADER_BYTES);
    const window = head.getUint16(0, true), signals = head.getUint16(2, true), count = head.getUint32(4, true);
    const first = head.getFloat64(8, true), newestMs = head.getFloat64(24, true);
    if (window !== this.window || signals !== this.low.length || newestMs < this.newestMs - 1000) {
      this.clear();
      this.window = window;
      for (let s = 0; s < signals; s++) {
        this.low.push(new Float32Array(BUCKETS).fill(NaN));
        this.high.push(new Float32Array(BUCKETS).fill(NaN));
      }
    }
    this.widthMs = head.getFloat64(16, true);
    this.newestMs = newestMs;
    const values = new Float32Array(buffer, HEADER_BYTES);
    for (let i = 0; i < count; i++) {
      const slot = (first + i) % BUCKETS;
      for (let s = 0; s < signals; s++) {
        this.low[s][slot] = values[2 * (i * signals + s)];
        this.high[s][slot] = values[2 * (i * signals + s) + 1];
      }
    }
    this.newest = first + count - 1;
    this.frames++;
    const offset = newestMs - now;
    this.offset = this.offset === null || Math.abs(offset - this.offset) > 500 ? offset : this.offset + 0.05 * (offset - this.offset);
  }

  // Right edge of the charts on the wall clock in ms: goes on between frames, stops soon after the last one.
  edge(now) {
    return Math.min(this.offset + now, this.newestMs + 300);
  }

  // Times (s) of two points for each bucket, oldest first; x and y arrays have 2 * BUCKETS entries.
  times(x) {
    const first = this.newest - BUCKETS + 1, w = this.widthMs / 1000;
    for (let i = 0; i < BUCKETS; i++) {
      x[2 * i] = (first + i + 0.25) * w;
      x[2 * i + 1] = (first + i + 0.75) * w;
    }
  }

  // A bucket whose two values are less than `least` apart is one point: no eye sees more, and the line is half as long.
  points(signal, y, least) {
    const low = this.low[signal], high = this.high[signal];
    let slot = (this.newest + 1) % BUCKETS;
    for (let i = 0; i < BUCKETS; i++) {
      const a = low[slot], b = high[slot];
      y[2 * i] = a === a ? a : null;
      y[2 * i + 1] = b === b ? (b - a < least ? undefined : b) : null;
      if (++slot === BUCKETS) slot = 0;
    }
  }

  // Smallest and largest value between two times in s, without them of all that is held; null without any.
  extremes(signal, from = -Infinity, to = Infinity) {
    const low = this.low[signal], high = this.high[signal], oldest = this.newest - BUCKETS + 1, w = this.widthMs / 1000;
    const first = Math.max(oldest, Math.floor(from / w)), last = Math.min(this.newest, Math.ceil(to / w));
    let min = Infinity, max = -Infinity;
    for (let n = first; low && n <= last; n++) {
      const i = ((n % BUCKETS) + BUCKETS) % BUCKETS;
      if (low[i] < min) min = low[i];
      if (high[i] > max) max = high[i];
    }
    return min <= max ? [min, max] : null;
  }
}

Store.BUCKETS = BUCKETS;
