// The page of a sweep: lines over one axis, a map over two, clouds over more, and what every mode does.

const CONFIG = {
  responsive: true,
  displaylogo: false,
  modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"],
  displayModeBar: matchMedia("(hover: hover)").matches ? "hover" : false,
};
const SEQUENTIAL = "Viridis",
  UNSTABLE = "#f3d9cf";
const shownData = run.shown,
  axes = run.axes,
  boundaries = run.boundaries ?? [];
const at = (id) => document.getElementById(id);
const isGrid = run.sampling === "grid";

function values(name, list) {
  return scaled(list, quantity(name).factor);
}

function positive(list) {
  return list.filter((x) => typeof x === "number" && x > 0);
}

// Over two decades and more only logarithms show both ends.
function spansDecades(lists) {
  const known = lists.flat().filter((x) => typeof x === "number");
  const up = positive(known);
  if (up.length < known.length || up.length === 0) return false;
  return up.reduce((a, b) => Math.max(a, b)) > 50 * up.reduce((a, b) => Math.min(a, b));
}

// A tick at each decade, or at fewer of them as powers of ten where there are many.
function scale(name, logarithmic, lists = [], more = {}) {
  if (!logarithmic) return axis(heading(name), more);
  const known = positive(lists.flat());
  const most = known.reduce((a, b) => Math.max(a, b), 1e-300),
    least = known.reduce((a, b) => Math.min(a, b), Infinity);
  const many = most > 1e5 * least;
  const powers = { type: "log", exponentformat: "power", nticks: 8 };
  // Within two decades, 2 and 5 have a number too.
  if (most < 100 * least) return decades(heading(name), { dtick: "D2", ...more });
  return many ? axis(heading(name), { ...powers, ...more }) : decades(heading(name), more);
}

function axisScale(each) {
  if (each.labels)
    return axis(heading(each.name), { tickvals: each.labels.map((_, k) => k), ticktext: each.labels.map(plain) });
  return scale(each.name, each.scale === "log", [values(each.name, shownData.axes[each.name])]);
}

function crossings(each) {
  const lines = boundaries
    .filter((found) => axes.length === 1)
    .map((found) =>
      levelLine(found.at[each.name] * quantity(each.name).factor, "y", found.loses ? "stability lost" : "regained"),
    );
  return {
    shapes: lines.map((line) => line.shape),
    annotations: lines.map((line) => placed(line, "x", each.scale === "log")),
  };
}

function lineFigure(name) {
  const [only] = axes,
    y = values(name, shownData.scalars[name]);
  return {
    data: [
      {
        type: "scatter",
        mode: y.length > 60 ? "lines" : "lines+markers",
        x: values(only.name, shownData.axes[only.name]),
        y,
        line: { color: BLUE, width: 1.6 },
        connectgaps: false,
      },
    ],
    layout: layout({ xaxis: axisScale(only), yaxis: scale(name, spansDecades([y]), [y]), ...crossings(only) }),
  };
}

function mapFigure(name) {
  const [slow, fast] = axes,
    [rows, columns] = shownData.shape;
  const flat = values(name, shownData.scalars[name]);
  const logarithmic = spansDecades([flat]);
  const shownValues = logarithmic ? flat.map((x) => (x === null ? null : Math.log10(x))) : flat;
  const z = Array.from({ length: rows }, (_, k) => shownValues.slice(k * columns, (k + 1) * columns));
  const x = values(fast.name, shownData.axes[fast.name].slice(0, columns));
  const y = values(
    slow.name,
    Array.from({ length: rows }, (_, k) => shownData.axes[slow.name][k * columns]),
  );
  const { unit } = quantity(name);
  const title = logarithmic ? `log₁₀${unit ? ` (${unit})` : ""}` : unit;
  return {
    data: [
      {
        type: "heatmap",
        x,
        y,
        z,
        ...(name === "stable"
          ? { colorscale: [[0, UNSTABLE], [1, SKY]], showscale: false, zmin: 0, zmax: 1 }
          : { colorscale: SEQUENTIAL }),
        colorbar: { title: { text: plain(title), side: "right" }, thickness: 12, outlinewidth: 0 },
        hoverongaps: false,
      },
      ...contour(fast, slow),
    ],
    layout: layout({ xaxis: axisScale(fast), yaxis: axisScale(slow), plot_bgcolor: UNSTABLE }),
  };
}

function contour(fast, slow) {
  const branches = new Map();
  for (const found of boundaries) branches.set(found.branch, [...(branches.get(found.branch) ?? []), found]);
  const place = (each, found) =>
    each.labels ? each.labels.indexOf(found.at[each.name]) : found.at[each.name] * quantity(each.name).factor;
  return [...branches.values()].map((branch) => ({
    type: "scatter",
    mode: branch.length > 1 ? "lines" : "markers",
    x: branch.map((found) => place(fast, found)),
    y: branch.map((found) => place(slow, found)),
    text: branch.map((found) => `mode ${found.structural_mode}, ${number(found.frequency / (2 * Math.PI))} Hz`),
    line: { color: VERMILION, width: 2 },
    marker: { color: VERMILION },
    name: "stability boundary",
  }));
}

function cloudFigure(name) {
  const [first, second] = axes;
  const y = values(name, shownData.scalars[name]);
  const color = second ? values(second.name, shownData.axes[second.name]) : BLUE;
  return {
    data: [
      {
        type: "scatter",
        mode: "markers",
        x: values(first.name, shownData.axes[first.name]),
        y,
        marker: {
          size: 4,
          color,
          ...(second ? { colorscale: SEQUENTIAL, colorbar: { title: { text: plain(heading(second.name)), side: "right" }, thickness: 12 } } : {}),
        },
      },
    ],
    layout: layout({ xaxis: axisScale(first), yaxis: scale(name, spansDecades([y]), [y]), ...crossings(first) }),
  };
}

function scalarFigure(name) {
  if (isGrid && axes.length === 1) return lineFigure(name);
  return shownData.shape.length === 2 ? mapFigure(name) : cloudFigure(name);
}

function modeColor(k, count) {
  return `hsl(${200 + (160 * k) / Math.max(count - 1, 1)} 60% ${32 + 18 * (k % 2)}%)`;
}

// One curve or cloud per mode, its abscissa an axis or another output of the same mode.
function modeFigure(name, abscissa, more) {
  const lists = shownData.modes[name];
  const size = name === "one_minus_separation" ? Math.abs : (x) => x;
  const curves = lists.map((list) => values(name, list).map((x) => (x === null ? null : size(x))));
  const logarithmic = spansDecades([positive(curves.flat())]) && name !== "pole_zero_separation";
  return {
    data: curves.map((y, k) => ({
      type: "scatter",
      mode: isGrid && axes.length === 1 ? "lines" : "markers",
      x: abscissa(k),
      y,
      name: `mode ${k + 1}`,
      line: { width: 1.2, color: modeColor(k, curves.length) },
      marker: { size: 3, color: modeColor(k, curves.length) },
    })),
    layout: layout({
      yaxis: scale(name, logarithmic, curves, name === "one_minus_separation" ? { title: { text: "|1 − β|" } } : {}),
      ...more,
    }),
  };
}

function panel(id, caption, figure) {
  const body = element("div", { id, class: "plot", role: "img", "aria-labelledby": `${id}-caption` });
  const text = element("figcaption", { id: `${id}-caption` }, caption);
  at("figures").append(element("figure", { class: "half" }, body, text));
  Plotly.newPlot(body, figure.data, figure.layout, CONFIG);
}

function fillFigures() {
  Object.keys(shownData.scalars).forEach((name, k) => {
    const where = axes.map((each) => quantity(each.name).label).join(" and ");
    const needs = /jitter_|step_|modulus_margin/.test(name);
    const blank = needs ? " It has no value where the loop is unstable." : "";
    panel(`scalar-${k}`, `${capital(quantity(name).label)} over ${where}.${blank}`, scalarFigure(name));
  });
  const first = axes[axes.length - 1],
    reaction = shownData.modes.effective_modal_reaction_inertia;
  Object.keys(shownData.modes).forEach((name, k) => {
    const along = values(first.name, shownData.mode_axes[first.name]);
    const what = capital(quantity(name).label);
    panel(
      `mode-${k}`,
      `${what} of every mode over ${quantity(first.name).label}.`,
      modeFigure(name, () => along, { xaxis: axisScale(first), ...crossings(first) }),
    );
    if (reaction && ["pole_zero_separation", "one_minus_separation"].includes(name)) {
      panel(
        `reaction-${k}`,
        `${what} against effective modal reaction inertia: the more of the mirror's reaction a mode takes, the ` +
          "farther its pole parts from its zero.",
        modeFigure(name, (j) => reaction[j], {
          xaxis: scale("effective_modal_reaction_inertia", true, reaction),
        }),
      );
    }
  });
}

function fillBoundaries() {
  if (run.boundaries === null) return;
  at("boundaries").hidden = false;
  at("boundaries-text").textContent = boundaries.length
    ? "Values at which the outermost pole neither grows nor decays, found to a relative accuracy of 10⁻⁹."
    : "Stability does not change anywhere along the axis.";
  if (!boundaries.length) return;
  const heads = [
    ...axes.map((each) => [heading(each.name), "n"]),
    ["As it rises", ""],
    ["Frequency (Hz)", "n"],
    ["Structural mode", ""],
  ];
  const rows = boundaries.slice(0, 500).map((found) =>
    element(
      "tr",
      {},
      ...axes.map((each) => {
        const value = found.at[each.name];
        const text = typeof value === "number" ? number(value * quantity(each.name).factor, 7) : String(value);
        return element("td", { class: "n" }, text);
      }),
      element("td", {}, found.loses ? "loses stability" : "regains stability"),
      element("td", { class: "n" }, number(found.frequency / (2 * Math.PI), 5)),
      element(
        "td",
        {},
        `${found.structural_mode} (${number(found.structure_frequency / (2 * Math.PI))} Hz on its own)`,
      ),
    ),
  );
  const head = element("tr", {}, ...heads.map(([text, kind]) => element("th", { scope: "col", class: kind }, text)));
  at("boundaries-table").append(
    element("table", {}, element("thead", {}, head), element("tbody", {}, ...rows)),
  );
}

function fillHeader() {
  document.title = `${run.name} – fosopt sweep`;
  at("name").textContent = run.name;
  at("description").textContent = run.description ?? "";
  const parts = [`${run.finished} of ${run.count} points`];
  if (typeof run.unstable === "number") parts.push(`${run.unstable} unstable`);
  if (run.failed) parts.push(`${run.failed} without all values (${run.reason})`);
  if (run.interrupted) parts.push("interrupted");
  at("summary").textContent = `${parts.join(", ")}.${shownData.thinned ? " Figures show a part of the points." : ""}`;
  const facts = Object.entries(run.provenance).map(([term, value]) =>
    element("div", {}, element("dt", {}, term), element("dd", {}, String(value))),
  );
  at("provenance-list").append(...facts);
}

fillHeader();
fillBoundaries();
fillFigures();
