// What a chart has loaded: a list of cycles, and a list of values for each name.

const LONGEST = 4000;  // Cycles before a chart is asked for anew, thinned out.

/** @typedef {{cycle: number[], [name: string]: any[]}} History */

/** @returns {History} */
export const empty = () => ({cycle: []});

// What came while older cycles were asked for stays behind them.
export function joined(loaded, newer, cycle) {
  const last = loaded.cycle.at(-1) ?? -1, kept = newer.cycle.map(value => value > last && value <= cycle);
  for (const name in newer) loaded[name] = (loaded[name] ?? []).concat(newer[name].filter((_, row) => kept[row]));
  return loaded;
}

export const hasRoom = (history, more) => history.cycle.length + more.cycle.length < LONGEST;

// Add newer cycles, and drop those before the first one that is shown.
/** @returns {History} */
export function appended(history, newer, first) {
  const found = history.cycle.findIndex(value => value >= first), drop = Math.max(found, 0);
  const next = empty();
  for (const name in newer) next[name] = (history[name] ?? []).slice(drop).concat(newer[name]);
  return next;
}
