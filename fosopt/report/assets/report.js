// The page: fills the header and the overview once, and the rest anew for each selected point.

const CONFIG = {
  responsive: true,
  displaylogo: false,
  modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  // Without a pointer that hovers the tools would cover every figure for good.
  displayModeBar: matchMedia("(hover: hover)").matches ? "hover" : false,
};

// [id, width of the panel, height class, caption, figure or table]
const PANELS = [
  ["structure", "full", "", structureCaption, structureFigure],
  ["metrics", "half", null, () => "Metrics of this point.", metricsTable],
  ["variables", "half", null, () => "Design variables; a range opens to its values.", variablesTable],
  ["history", "half", "", historyCaption, historyFigure],
  [
    "constraints",
    "full",
    null,
    () =>
      "Constraints, with the slack to the nearer bound; of active ones the multiplier, and in words what a little more " +
      "of the bound changes.",
    constraintsTable,
  ],
  [
    "account",
    "full",
    null,
    () =>
      "Two-sided account: what this design has against what provably no other could. Structures are compared with the " +
      "structure's requirements alone, controllers on this very structure.",
    accountTable,
  ],
  [
    "jitter",
    "half",
    "",
    () => "Line-of-sight jitter by source; they add as root sum of squares. Percent: share of the mean square.",
    jitterFigure,
  ],
  [
    "by-mode",
    "half",
    "",
    ofModel(
      "Line-of-sight jitter by closed-loop mode: covariance of a mode's part of the line of sight with the whole. Shares " +
        "add to one; one below zero counteracts the others.",
    ),
    byModeFigure,
  ],
  [
    "cumulative",
    "half",
    "",
    (point) => [
      ofModel("Cumulative jitter by source: root mean square of all that lies below a frequency.")(point),
      ...lineVerdict(point),
    ],
    cumulativeFigure,
  ],
  [
    "mode-curves",
    "half",
    "",
    ofModel("Cumulative jitter by mode: share in the mean square of all that lies below a frequency."),
    modeCurvesFigure,
  ],
  [
    "spectrum",
    "full",
    "",
    ofModel("Spectrum of the line of sight by source, one-sided, six decades from its peak."),
    spectrumFigure,
  ],
  ["bode", "half", "tall", bodeCaption, bodeFigure],
  ["sensitivity", "half", "tall", sensitivityCaption, sensitivityFigure],
  ["step", "half", "", asSampled("Response to a step command; the window is shaded.", ", between samples too"), stepFigure],
  ["window", "half", "", asSampled("Error after the step within its window.", ", between samples too"), windowFigure],
  [
    "poles",
    "half",
    "",
    ofModel("Closed-loop poles, one of each conjugate pair: natural frequency and damping ratio."),
    polesFigure,
  ],
  ["shape", "full", "", shapeCaption, shapeFigure],
  ["modes", "full", null, modesCaption, modesTable],
];

const byKey = new Map(points.map((point) => [String(point.key), point]));
const at = (id) => document.getElementById(id);
const drawn = new Set();
let selected = null;
let pending = 0;

function bodeCaption(point) {
  const closed = hasTwoAxes(point) ? " About each axis, with the loop about the other one closed." : "";
  const text = asSampled(
    detailOf(point).bode?.loop_phase_deg
      ? "Loop transfer L: magnitude, and phase counted by its poles and zeros. Dotted: 0 dB and −180° (plus whole turns)."
      : "Magnitude of the loop transfer L. Its phase is left out: a zero of L could not be found.",
  )(point);
  return text + closed;
}

function sensitivityCaption(point) {
  return asSampled(
    point.status === "unstable"
      ? "Sensitivity S and complementary sensitivity T of an unstable closed loop: they bound no margin."
      : hasTwoAxes(point)
        ? "Sensitivity S and complementary sensitivity T about each axis; the higher peak of |S| is one over the modulus margin."
        : "Sensitivity S and complementary sensitivity T; the peak of |S| is one over the modulus margin.",
  )(point);
}

function draw(id, figure) {
  const target = at(id);
  drawn.add(id);
  return Plotly.react(target, figure.data, figure.layout, CONFIG);
}

function release(id) {
  if (drawn.delete(id)) Plotly.purge(at(id));
}

function makePanels() {
  for (const [id, width, height] of PANELS) {
    const caption = element("figcaption", { id: `${id}-caption` });
    const holder = { id, "aria-labelledby": `${id}-caption`, role: height === null ? "region" : "img" };
    const content =
      height === null
        ? element("div", { ...holder, class: `scroll ${id === "modes" ? "limited" : ""}`, tabindex: "0" })
        : element("div", { ...holder, class: `plot ${height}` });
    const body = height === null ? content : element("div", { class: "scroll" }, content);
    const figure = element("figure", {
      class: `${width} ${height === null ? "tabular" : ""}`,
      id: `${id}-panel`,
    });
    // A table's caption stands above it, a figure's below, as in print.
    figure.append(...(height === null ? [caption, body] : [body, caption]));
    if (["structure", "shape"].includes(id)) figure.prepend(viewButtons(id));
    at("figures").append(figure);
  }
}

function fillPanel([id, , height, caption, make], point) {
  const made = make(point);
  at(`${id}-panel`).hidden = !made;
  if (!made) {
    if (height !== null) release(id);
    return;
  }
  at(`${id}-caption`).replaceChildren(...[caption(point)].flat());
  if (height === null) at(id).replaceChildren(made);
  else draw(id, made);
}

// How far the design model's jitter is from that of the full-order model, where it keeps fewer modes.
function truncation(point) {
  const error = point.truncation_error?.jitter_total;
  return typeof error === "number" ? `${number(100 * error, 2)}\u00a0%` : null;
}

function facts(point) {
  const parent = point.parent !== null && point.parent !== undefined ? byKey.get(String(point.parent)) : null;
  const known = [
    ["State", mark(point)],
    ["Status", point.status],
    ["Strategy", point.strategy && strategyName(point.strategy)],
    ["Case", point.case],
    ["Started from", parent && pick(parent.key, `point ${parent.key}`)],
    ["Iterations", point.iterations],
    ["Time", typeof point.seconds === "number" ? `${number(point.seconds, 3)}\u00a0s` : null],
    ["Starts that agree", point.starts ? `${point.starts.agreed} of ${point.starts.tried}` : null],
    ["Truncation error of the jitter", truncation(point)],
    ["Requirement line", run.requirement_line && lineMark(point)],
    ["KKT residual", typeof point.kkt_residual === "number" ? number(point.kkt_residual, 2) : null],
  ];
  return known
    .filter(([, value]) => value !== null && value !== undefined && value !== "")
    .map(([term, value]) =>
      element(
        "div",
        {},
        element("dt", {}, term),
        element("dd", {}, value instanceof Node ? value : String(value)),
      ),
    );
}

function pick(key, text) {
  return element("button", { type: "button", class: "pick", "data-key": key }, text);
}

function valuesOf(point) {
  return objectives
    .map((name, index) => {
      const value = objective(point, index);
      return `${quantity(name).label} ${value === null ? "without a value" : shown(name, value)}`;
    })
    .join(", ");
}

function showPoint() {
  const point = selected,
    title = titleOf(point);
  at("selected-title").textContent = `Point ${point.key}${title ? `: ${title}` : ""}`;
  at("bar-text").textContent = `Point ${point.key} · ${valuesOf(point)} · ${verdict(point)}`;
  at("facts").replaceChildren(...facts(point));
  const unwell = !isSound(point);
  const reason = point.reason ?? (unwell ? `No reason was recorded.` : "");
  at("reason").hidden = !reason;
  at("reason").textContent = reason ? `${capital(verdict(point))}: ${readable(reason)}` : "";
  if (hasFront()) Plotly.restyle("front", ringOf(point), [at("front").data.length - 1]);
  else if (drawn.has("front")) draw("front", barsFigure(point.key));
  for (const views of document.querySelectorAll(".views")) views.hidden = !isSpatial(point);
  const { structure, truss } = detailOf(point);
  at("structure").classList.toggle("low", Boolean(structure));
  at("shape").classList.toggle("low", Boolean(structure) || Boolean(truss && isSlender(truss)));
  for (const id of ["structure", "shape"]) at(id).classList.toggle("wide", !isSpatial(point));
  PANELS.forEach((panel) => fillPanel(panel, point));
  at("announcement").textContent = `Point ${point.key} selected: ${valuesOf(point)}, ${verdict(point)}.`;
}

function select(key, { link = true } = {}) {
  const point = byKey.get(String(key));
  if (!point || point === selected) return;
  selected = point;
  for (const row of document.querySelectorAll("tr[data-key]")) {
    const current = row.dataset.key === String(point.key);
    row.classList.toggle("current", current);
    row.querySelector("button.pick").setAttribute("aria-pressed", String(current));
    if (current && at("points").contains(row)) keepInView(at("points"), row);
  }
  if (link) history.replaceState(null, "", `#point=${encodeURIComponent(point.key)}`);
  // A held arrow key asks for points faster than all panels can be drawn.
  cancelAnimationFrame(pending);
  pending = requestAnimationFrame(showPoint);
}

// Scrolls the table alone: the page stays where the reader is.
function keepInView(box, row) {
  const head = box.querySelector("thead").offsetHeight;
  const [top, bottom] = [row.offsetTop - head, row.offsetTop + row.offsetHeight];
  if (top < box.scrollTop) box.scrollTop = top;
  else if (bottom > box.scrollTop + box.clientHeight) box.scrollTop = bottom - box.clientHeight;
}

function step(by) {
  const order = ordered();
  const next = order[order.indexOf(selected) + by];
  if (!next) return;
  select(next.key);
  if (at("points").contains(document.activeElement))
    at("points").querySelector("tr.current button").focus({ preventScroll: true });
}

// Steps through the points: in their table and at the front by all arrows, elsewhere by those to the left and right,
// because the others scroll the page. Home and End go to the first and last point, Enter at the front to its details.
function onKey(event) {
  if (event.altKey || event.ctrlKey || event.metaKey || event.shiftKey) return;
  if (at("modes").contains(event.target)) return onModeKey(event);
  const atFront = at("front")?.contains(event.target) ?? false;
  const listed = at("points").contains(event.target) || atFront;
  const near = event.target === document.body || at("bar").contains(event.target);
  if (!listed && !near) return;
  if (atFront && event.key === "Enter") {
    at("selected").focus();
    event.preventDefault();
    return;
  }
  const order = ordered(),
    place = order.indexOf(selected);
  const target = {
    ArrowLeft: place - 1,
    ArrowRight: place + 1,
    ...(listed ? { ArrowUp: place - 1, ArrowDown: place + 1, Home: 0, End: order.length - 1 } : {}),
  }[event.key];
  if (target === undefined) return;
  event.preventDefault();
  step(target - place);
}

function fromAddress() {
  const found = /^#point=(.*)$/.exec(location.hash);
  if (!found) return null;
  try {
    return byKey.get(decodeURIComponent(found[1])) ?? null;
  } catch {
    return null;
  }
}

// Without a link the middle of the first strategy's verified points stands for the front.
function firstShown() {
  const good = ordered().filter(
    (point) => isSound(point) && !point.dominated && point.strategy === (strategies[0] ?? null),
  );
  return good[Math.floor((good.length - 1) / 2)] ?? ordered()[0];
}

function summary() {
  const sound = points.filter(isSound);
  const count =
    points.length === 1 ? `One ${run.kind === "analysis" ? "design" : "point"}` : `${points.length} points`;
  const verified =
    points.length === 1
      ? sound.length
        ? "verified"
        : verdict(points[0])
      : `${sound.length} of them verified`;
  const best = objectives.flatMap((name, index) => {
    const known = sound.filter((point) => objective(point, index) !== null);
    if (!known.length) return [];
    const least = known.reduce((a, b) => (objective(b, index) < objective(a, index) ? b : a));
    const value = shown(name, objective(least, index));
    return [
      points.length === 1
        ? `${quantity(name).label} ${value}`
        : `least ${quantity(name).label} ${value} (point ${least.key})`,
    ];
  });
  return `${count}, ${verified}${best.length ? `: ${best.join("; ")}` : ""}.`;
}

function showOverview() {
  at("overview").hidden = false;
  at("points").replaceChildren(pointsTable());
  at("points-hint").textContent =
    "Click a point or a row, or step with the arrow keys, Home and End; all below follows. Enter at the front goes to " +
    "the selected point.";
  if (hasFront()) {
    const [first, second] = objectives.map((name) => quantity(name).label);
    at("overview-title").textContent = `${capital(second)} against ${first}`;
    at("front").setAttribute("aria-label", `${capital(second)} against ${first}. Arrow keys step through the points.`);
    at("front-caption").textContent = frontCaption();
    return draw("front", frontFigure());
  }
  at("overview-title").textContent =
    objectives.length === 1 ? capital(quantity(objectives[0]).label) : "Points";
  const bars = objectives.length ? barsFigure(null) : null;
  if (!bars) {
    at("front").closest("figure").remove();
    at("overview").querySelector(".overview").classList.add("single");
    return null;
  }
  at("front-caption").textContent =
    `${capital(quantity(objectives[0]).label)} of each point; hatched bars are not verified.`;
  at("front").classList.remove("tall");
  return draw("front", bars);
}

// Paper is narrower than a screen, and figures do not shrink by themselves.
function fitToPaper(printing) {
  document.documentElement.classList.toggle("printing", printing);
  // On paper nothing opens with a click; what a bound assumes belongs to it.
  for (const each of document.querySelectorAll("#account details")) each.open = printing;
  for (const id of drawn) {
    const size = printing
      ? { autosize: false, width: at(id).clientWidth, height: at(id).clientHeight }
      : { autosize: true, width: null, height: null };
    Plotly.relayout(id, size);
  }
}

function listen() {
  document.addEventListener("click", (event) => {
    const found = event.target instanceof Element ? event.target.closest("[data-key]") : null;
    if (found) select(found.dataset.key);
    const mode = event.target instanceof Element ? event.target.closest("[data-mode]") : null;
    if (mode) chooseMode(Number(mode.dataset.mode));
  });
  document.addEventListener("keydown", onKey);
  at("previous").addEventListener("click", () => step(-1));
  at("next").addEventListener("click", () => step(1));
  addEventListener("hashchange", () => {
    const point = fromAddress();
    if (point) select(point.key, { link: false });
  });
  addEventListener("beforeprint", () => fitToPaper(true));
  addEventListener("afterprint", () => fitToPaper(false));
  if (drawn.has("front")) {
    at("front").on("plotly_click", (event) => {
      const key = event.points[0].customdata;
      if (key !== undefined) select(key);
    });
  }
}

function told(value) {
  if (value === null || value === undefined) return missing;
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (Array.isArray(value)) return value.map(told).join(", ");
  if (typeof value !== "object") return String(value);
  return Object.entries(value)
    .map(([name, each]) => `${name.replaceAll("_", " ")} ${told(each)}`)
    .join(", ");
}

function definitions(entries) {
  return entries.map(([term, value]) =>
    element("div", {}, element("dt", {}, term.replaceAll("_", " ")), element("dd", {}, told(value))),
  );
}

function start() {
  document.title = run.name ? `${run.name} · fosopt` : "fosopt report";
  at("kicker").textContent =
    run.kind === "analysis" ? "fosopt · design analysis" : "fosopt · co-design study";
  at("name").textContent = run.name || "fosopt report";
  at("description").textContent = run.description ?? "";
  at("summary").textContent = points.length ? summary() : "This run has no points.";
  const provenance = Object.entries(run.provenance ?? {});
  at("provenance").hidden = !provenance.length;
  at("provenance-list").replaceChildren(...definitions(provenance));
  if (!points.length) return;
  if (points.length > 1) showOverview();
  const cases = points.filter((point) => point.case);
  if (cases.length && objectives.length) {
    at("cases").hidden = false;
    at("cases-table").replaceChildren(casesTable(cases));
  }
  if (run.comparison?.length) {
    at("comparison").hidden = false;
    at("comparison-text").textContent = comparisonText();
    at("comparison-table").replaceChildren(comparisonTable());
    const gains = gainFigure();
    at("gain-panel").hidden = !gains;
    if (gains) draw("gain", gains);
  }
  at("selected").hidden = false;
  at("bar").hidden = points.length === 1;
  makePanels();
  listen();
  const linked = fromAddress();
  select((linked ?? firstShown()).key, { link: false });
}

start();
