// What happens in the cycle shown, in a sentence: who lacks power, and who gives it.

import {power} from "./chart.js";

const LEAST_KW = 0.05, NAMED = 2;

function named(nodes) {
  const text = nodes.slice(0, NAMED).map(({path, kw}) => `${path} ${power(kw).join(" ")}`);
  const rest = nodes.slice(NAMED);
  if (rest.length) text.push(`${rest.length} more ${power(rest.reduce((sum, {kw}) => sum + kw, 0)).join(" ")}`);
  return text.join(", ");
}

export function sentence(plan, {nodes}) {
  const far = plan.nodes.map(({path, inverter}, number) => ({path, inverter, kw: nodes.power[number] - nodes.share[number]}))
    .filter(({inverter, kw}, number) => inverter && nodes.power[number] !== null && nodes.share[number] !== null && Math.abs(kw) >= LEAST_KW);
  const lacking = far.filter(({kw}) => kw < 0).map(node => ({...node, kw: -node.kw})).sort((a, b) => b.kw - a.kw);
  const gives = far.filter(({kw}) => kw > 0).sort((a, b) => b.kw - a.kw);
  if (!lacking.length) return "no inverter is below its share";
  return `${named(lacking)} lacking; ${gives.length ? `help from ${named(gives)}` : "nobody has more to give"}`;
}
