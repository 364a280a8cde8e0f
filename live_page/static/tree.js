// The control tree, a row for each process: its state, missed inputs, loop time, restarts.

const FOLDED_ABOVE = 30;
const LEVELS = ["good", "late", "bad"], SIGNS = ["●", "○", "✕"];
export function controlTree(body, plan, select) {
  const plant = {path: "plant", parent: null, number: null, depth: 0, children: []};
  const rows = plan.nodes.map((node, number) => ({...node, number, children: []}));
  for (const row of rows) if (row.parent !== null) rows[row.parent].children.push(row);
  const order = [plant];
  const visit = (row, depth) => { row.depth = depth; order.push(row); row.children.forEach(child => visit(child, depth + 1)); };
  visit(rows[0], 0);
  const many = rows.filter(row => row.inverter).length > FOLDED_ABOVE;
  for (const row of order) {
    row.agent = row.number === null ? 0 : row.number + 1;  // The frame lists the plant first.
    row.folded = many && row.children.some(child => child.inverter) && row.depth > 0;
    const line = row.line = document.createElement("tr");
    const name = line.insertCell();
    name.style.paddingLeft = `${row.depth * 18}px`;
    if (row.depth > 0 && row.children.length) {
      row.fold = Object.assign(document.createElement("button"), {className: "fold", title: "open or fold"});
      row.fold.addEventListener("click", event => { event.stopPropagation(); row.folded = !row.folded; arrange(); });
      name.append(row.fold);
    }
    name.append(row.path === "plant" ? "plant" : row.path.split("/").pop() || "central");
    if (row.external || row.device) name.append(row.device ? " (Modbus)" : " (device)");
    row.cells = Array.from({length: 5}, (_, column) => { const cell = line.insertCell(); if (column) cell.className = "n"; return cell; });
    if (row.number !== null) line.addEventListener("click", () => select(row.number));
  }
  body.replaceChildren(...order.map(row => row.line));

  let frame = null, selected = null;
  const below = row => [row, ...row.children.flatMap(below)];
  function arrange() {
    const hidden = new Set(order.filter(row => row.folded).flatMap(row => below(row).slice(1)));
    for (const row of order) {
      row.line.hidden = hidden.has(row);
      if (row.fold) row.fold.textContent = row.folded ? "▸" : "▾";
    }
    if (frame) show(frame);
  }
  function show(next) {
    frame = next;
    const agents = frame.agents;
    for (const row of order) {
      if (row.line.hidden) continue;
      const own = row.agent, heard = !agents.level[own];
      const unread = frame.unread.includes(row.number);
      const hidden = row.folded ? below(row).slice(1) : [];
      const worst = Math.max(agents.level[own], unread ? 2 : 0, ...hidden.map(each => agents.level[each.agent]));
      const [state, inputs, oldest, loop, restarts] = row.cells;
      const ill = hidden.filter(each => agents.level[each.agent]).length;
      const own_text = unread && heard ? "no reading" : agents.text[own];
      state.className = LEVELS[worst];
      state.textContent = `${SIGNS[worst]} ${ill && !agents.level[own] ? `${ill} below missing` : own_text}`;
      const now = agents.missed_now[own];
      inputs.textContent = agents.missed_inputs[own].toLocaleString("en");
      inputs.classList.toggle("late", now > 0);
      inputs.title = now ? `${now} of them in this cycle` : "";
      oldest.textContent = agents.input_age[own] || "–";
      loop.textContent = agents.loop_ms[own]?.toFixed(2) ?? "–";
      restarts.textContent = agents.restarts[own];
    }
  }
  arrange();
  return {
    show,
    select(number) {
      order.find(row => row.number === selected)?.line.classList.remove("selected");
      selected = number;
      const row = order.find(row => row.number === number);
      for (let parent = row?.parent; parent != null; parent = rows[parent].parent) rows[parent].folded = false;
      arrange();
      row?.line.classList.add("selected");
    },
    order: order.filter(row => row.number !== null).map(row => row.number),
  };
}
