// Samples of one gripper in a ring of typed arrays, so that a page uses no more memory after a week than after ten
// minutes.

/** Times are in ms, of a monotonic clock. An unknown value is NaN. */
export class Samples {
  constructor(capacity, columns = 3) {
    this.capacity = capacity;
    this.times = new Float64Array(capacity);
    this.columns = Array.from({ length: columns }, () => new Float32Array(capacity));
    this.start = 0;
    this.length = 0;
  }

  push(time, values) {
    const at = (this.start + this.length) % this.capacity;
    this.times[at] = time;
    this.columns.forEach((column, index) => {
      column[at] = values[index] ?? NaN;
    });
    if (this.length < this.capacity) this.length += 1;
    else this.start = (this.start + 1) % this.capacity;
  }

  /** Puts older samples, each `[time, values]`, before the present ones. */
  fill(older) {
    const own = Array.from({ length: this.length }, (_, index) => [
      this.time(index),
      this.columns.map((_column, column) => this.value(column, index)),
    ]);
    const begin = own[0]?.[0] ?? Infinity;
    [this.start, this.length] = [0, 0];
    for (const [time, values] of [...older.filter(([time]) => time < begin), ...own]) this.push(time, values);
  }

  /** Marks the time between the newest sample and the next one as unknown. */
  gap() {
    const last = this.length - 1;
    if (last >= 0 && !this.#isGap(last)) this.push(this.time(last), []);
  }

  time(index) {
    return this.times[(this.start + index) % this.capacity];
  }

  value(column, index) {
    return this.columns[column][(this.start + index) % this.capacity];
  }

  /** The first index whose time is not before `time`. */
  indexOf(time) {
    let low = 0;
    let high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time(middle) < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  /**
   * Returns the samples from `from` to `to` for uPlot: seconds relative to `to`, then each column, with null for an
   * unknown value. If there are more than `points`, only the lowest and the highest of each stretch remain, so that
   * no peak is lost. The same columns are known in a whole stretch, so gaps remain too.
   */
  window(from, to, points) {
    const first = Math.max(0, this.indexOf(from) - 1);
    const last = this.indexOf(to);
    const stretch = Math.max(1, Math.ceil((2 * (last - first)) / points));
    const result = [[], ...this.columns.map(() => [])];
    for (let begin = first, end; begin < last; begin = end) {
      end = begin + 1;
      const known = this.#known(begin);
      const most = Math.min(begin + stretch, last);
      while (end < most && this.#known(end) === known) end += 1;
      if (end - begin === 1) this.#add(result, begin, to, [begin]);
      else this.#addExtremes(result, begin, end, to);
    }
    return result;
  }

  #isGap(index) {
    return this.#known(index) === 0;
  }

  /** The columns that are known in a sample: one bit each. */
  #known(index) {
    const at = (this.start + index) % this.capacity;
    return this.columns.reduce((bits, column, bit) => (Number.isNaN(column[at]) ? bits : bits | (1 << bit)), 0);
  }

  #add(result, index, to, indexes) {
    result[0].push((this.time(index) - to) / 1000);
    this.columns.forEach((_, column) => {
      const value = this.value(column, indexes[column] ?? index);
      result[column + 1].push(Number.isNaN(value) ? null : value);
    });
  }

  #addExtremes(result, begin, end, to) {
    const lows = [];
    const highs = [];
    this.columns.forEach((_, column) => {
      let low = begin;
      let high = begin;
      for (let index = begin + 1; index < end; index += 1) {
        const value = this.value(column, index);
        // Any value replaces an unknown one.
        if (!(this.value(column, low) <= value) && !Number.isNaN(value)) low = index;
        if (!(this.value(column, high) >= value) && !Number.isNaN(value)) high = index;
      }
      lows.push(Math.min(low, high));
      highs.push(Math.max(low, high));
    });
    this.#add(result, begin, to, lows);
    this.#add(result, end - 1, to, highs);
  }
}
