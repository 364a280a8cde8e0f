// The place in a run that an address names: #cycle=743&node=c2/inv07&from=700&to=800.

export function placeInAddress() {
  const parts = new URLSearchParams(location.hash.slice(1));
  const number = name => parts.has(name) && Number.isFinite(+parts.get(name)) ? +parts.get(name) : null;
  const from = number("from"), to = number("to");
  return {cycle: number("cycle"), node: parts.get("node"), span: from !== null && to > from ? {from, to} : null};
}

// While the newest cycle is followed the address names none.
export function keepInAddress({cycle, node, span}) {
  const parts = {...cycle !== null && {cycle}, ...node && {node}, ...span && {from: Math.floor(span.from), to: Math.ceil(span.to)}};
  const text = Object.entries(parts).map(([name, value]) => `${name}=${String(value).replaceAll(/[#&%]/g, encodeURIComponent)}`).join("&");
  history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
}
