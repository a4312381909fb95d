// Shapes of the modes in the table: the structure of one point, deformed.

const RESTING = "#c3c9d1";
const MOST_ACROSS = 0.08; // of the largest side, as which the largest displacement is drawn
const MOST_STRAIN = 0.4; // so that a picture of small displacements keeps the look of its bars
let chosenMode = null;

function hasShape(point, row) {
  return Boolean(detailOf(point).shapes?.values[row]);
}

const SEEN = 1e-12; // of J̄ₖ: of a pair of modes the mirror sees one
const OWN = 0.1; // from here on a mode without a zero is the mirror's own

// What the reader chose, where the point has it; else the mode of the structure that makes most of the jitter, or in
// which the mirror moves most.
function modeShown(point) {
  const rows = (detailOf(point).modes ?? []).map((_, row) => row).filter((row) => hasShape(point, row));
  if (!rows.length) return null;
  if (rows.includes(chosenMode)) return chosenMode;
  const modes = detailOf(point).modes;
  const share = (row) => Math.abs(modes[row].jitter_share ?? 0);
  const inertia = (row) => Math.abs(modes[row].effective_modal_reaction_inertia ?? 0);
  const most = (weight, among) => among.reduce((best, row) => (weight(row) > weight(best) ? row : best), among[0]);
  const loudest = most(share, rows);
  if (share(loudest) > 0 && inertia(loudest) > SEEN) return loudest;
  const structural = rows.filter((row) => typeof modes[row].pole_zero_separation === "number" || inertia(row) < OWN);
  return most(inertia, structural.length ? structural : rows);
}

function shapeOf(point, row) {
  const text = atob(detailOf(point).shapes.values[row]);
  return Array.from(text, (letter) => ((letter.charCodeAt(0) << 24) >> 24) / 127);
}

// One vector for each node, then one for each place.
function displacements(truss, shape) {
  const size = truss.nodes[0].length;
  return Array.from({ length: shape.length / size }, (_, index) => shape.slice(size * index, size * (index + 1)));
}

function moved(position, by, enlarged) {
  return position.map((value, k) => value + enlarged * by[k]);
}

// How large the largest displacement is drawn [m].
function enlargement(truss, by) {
  const largest = Math.max(...truss.nodes[0].map((_, k) => span(truss.nodes.map((node) => node[k])).size));
  const strains = [...truss.bars, ...(truss.battens ?? [])].map(
    ([i, j]) =>
      Math.hypot(...by[i].map((value, k) => value - by[j][k])) /
      Math.hypot(...truss.nodes[i].map((value, k) => value - truss.nodes[j][k])),
  );
  return Math.min(MOST_ACROSS * largest, MOST_STRAIN / Math.max(...strains, 1e-9));
}

function deformed({ truss, places = [] }, shape) {
  const by = displacements(truss, shape);
  const enlarged = enlargement(truss, by);
  const nodes = truss.nodes.map((node, index) => moved(node, by[index], enlarged));
  const after = by.slice(truss.nodes.length);
  return {
    enlarged,
    truss: { ...truss, nodes },
    places: places.map((place, index) => ({ ...place, xyz: moved(place.xyz, after[index], enlarged) })),
  };
}

function restingTrace(truss) {
  return line2d(segments(truss, [...truss.bars, ...(truss.battens ?? [])]), { color: RESTING, width: 1 });
}

function trussShape(detail, shape) {
  const { truss, places } = deformed(detail, shape);
  const spatial = detail.truss.nodes[0].length === 3;
  const directions = spatial ? picture(detail.truss) : null;
  const flat = (each) => (spatial ? { ...each, nodes: each.nodes.map(ontoPicture(directions)) } : each);
  const onto = spatial ? ontoPicture(directions) : (xyz) => xyz;
  const [rest, bent] = [flat(detail.truss), flat(truss)];
  const [x, y] = middles(bent);
  const hover = { mode: "markers", hoverinfo: "text", hovertext: barTexts(detail.truss), showlegend: false };
  const { right, up } = VIEWS[lookedFrom];
  const frame = spatial && right === null;
  const titles = spatial && !frame ? [`${"xyz"[right]} (m)`, `${"xyz"[up]} (m)`] : ["x (m)", "y (m)"];
  const across = frame ? frameless() : axis(titles[0], { showgrid: false, constrain: "domain" });
  const upward = frame ? frameless() : axis(titles[1], { showgrid: false, constrain: "domain" });
  return {
    data: [
      restingTrace(rest),
      ...drawnBars(bent).map((trace) => ({ ...trace, line: { ...trace.line, width: trace.line.width / 2 } })),
      ...(truss.bars.length ? [{ x, y, ...hover, marker: { size: 9, opacity: 0 } }] : []),
      ...placeTraces(places, (place) => onto(place.xyz)),
    ],
    layout: layout({ xaxis: across, yaxis: { ...upward, scaleanchor: "x", scaleratio: 1 } }),
  };
}

function between(values, share) {
  const place = share * (values.length - 1),
    low = Math.min(Math.floor(place), values.length - 2);
  return values[low] + (place - low) * (values[low + 1] - values[low]);
}

function beamShape({ structure, places = [] }, shape) {
  const x = shape.map((_, index) => (structure.length * index) / (shape.length - 1));
  return {
    data: [
      line2d([[0, structure.length], [0, 0]], { color: RESTING, width: 1 }),
      line2d([x, shape], { color: "#8b929b", width: 6, simplify: false }),
      ...placeTraces(places, ({ xyz }) => [xyz[0], between(shape, xyz[0] / structure.length)]),
    ],
    layout: layout({
      xaxis: axis("x (m)", {
        range: [-0.05 * structure.length, 1.05 * structure.length],
        showgrid: false,
        mirror: false,
      }),
      yaxis: frameless({ range: [-1.4, 1.4], fixedrange: true }),
    }),
  };
}

// A chain turns: angles stand over the bodies, and the mirror's beside that of the body which carries it.
function chainShape({ structure, places = [] }, shape, mirror) {
  const most = Math.max(1, Math.abs(mirror));
  const order = shape.map((_, index) => index);
  const angles = shape.map((angle) => angle / most);
  const carrier = structure.bodies.indexOf(places.find((place) => place.kind === "mirror")?.at);
  const stems = order.flatMap((index) => [index, index, null]);
  const mark = { symbol: PLACES.mirror.symbol, color: PLACES.mirror.color, size: 11 };
  return {
    data: [
      line2d([[-0.4, shape.length - 0.6], [0, 0]], { color: RESTING, width: 1 }),
      line2d([stems, angles.flatMap((angle) => [0, angle, null])], { color: RESTING, width: 3 }),
      {
        x: order,
        y: angles,
        mode: "lines+markers",
        line: { color: "#8b929b", width: 2 },
        marker: { size: 12, color: BLUE, line: { color: INK, width: 1 } },
        hoverinfo: "skip",
      },
      {
        x: [carrier + 0.12],
        y: [mirror / most],
        mode: "markers+text",
        text: ["mirror"],
        textposition: "middle right",
        textfont: { size: 11.5, color: PLACES.mirror.color },
        cliponaxis: false,
        hoverinfo: "skip",
        marker: mark,
      },
    ],
    layout: layout({
      xaxis: frameless({
        range: [-0.6, shape.length - 0.4],
        fixedrange: true,
        tickvals: order,
        ticktext: structure.bodies.map(plain),
        showticklabels: true,
      }),
      yaxis: axis("Angle (largest: 1)", { range: [-1.15, 1.15], fixedrange: true, showgrid: false, mirror: false }),
    }),
  };
}

function shapeFigure(point) {
  const row = modeShown(point);
  if (row === null) return null;
  const detail = detailOf(point),
    shape = shapeOf(point, row);
  if (detail.truss) return trussShape(detail, shape);
  if (detail.structure?.kind === "beam") return beamShape(detail, shape);
  return chainShape(detail, shape, detail.shapes.mirror[row]);
}

function shapeCaption(point) {
  const row = modeShown(point);
  if (row === null) return "";
  const detail = detailOf(point),
    mode = detail.modes[row];
  return [
    `Shape of mode ${mode.index}, ${number(mode.frequency_hz)} Hz: structure and mirror together, undamped and`,
    "with the loop open, as in the table of modes. Pale: at rest;",
    scaleSaid(detail, shapeOf(point, row)),
    turnSaid(detail, row),
  ].join(" ");
}

function scaleSaid(detail, shape) {
  if (detail.structure?.kind === "chain") return "angles of the bodies, the largest of all as one.";
  if (detail.structure) return "the largest displacement across the beam not to scale.";
  const { enlarged } = deformed(detail, shape);
  const size = `the largest displacement drawn as ${number(enlarged, 2)} m`;
  return `bars half as wide as in the picture of the truss, ${size}.`;
}

function turnSaid(detail, row) {
  const [mirror, port] = ["mirror", "port"].map((name) => number(detail.shapes[name][row], 3));
  return detail.structure?.kind === "chain"
    ? `The mirror turns by ${mirror} and its port by ${port} times the largest angle of a body.`
    : `For each millimeter of it the mirror turns by ${mirror} mrad and its port by ${port} mrad.`;
}

// Only what follows the mode is drawn anew.
function chooseMode(row) {
  if (!selected || !hasShape(selected, row)) return;
  chosenMode = row;
  fillPanel(PANELS.find(([id]) => id === "shape"), selected);
  for (const each of at("modes").querySelectorAll("tr[data-mode]")) {
    const current = Number(each.dataset.mode) === row;
    each.classList.toggle("current", current);
    each.querySelector("button").setAttribute("aria-pressed", String(current));
    if (current) keepInView(at("modes"), each);
  }
  const mode = detailOf(selected).modes[row];
  at("announcement").textContent = `Shape of mode ${mode.index} drawn, ${number(mode.frequency_hz)} Hz.`;
}

// In the table of modes the arrows up and down, Home and End step through those that have a shape.
function onModeKey(event) {
  const rows = [...at("modes").querySelectorAll("tr[data-mode]")].map((row) => Number(row.dataset.mode));
  const place = rows.indexOf(modeShown(selected));
  const target = { ArrowUp: place - 1, ArrowDown: place + 1, Home: 0, End: rows.length - 1 }[event.key];
  if (target === undefined || rows[target] === undefined) return;
  event.preventDefault();
  chooseMode(rows[target]);
  if (document.activeElement.closest("tr[data-mode]"))
    at("modes").querySelector("tr.current button").focus({ preventScroll: true });
}
