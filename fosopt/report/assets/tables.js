// The tables, for the run and for one point.

function table(caption, heads, rows, className = "") {
  const head = heads.map(([text, kind]) => element("th", { scope: "col", class: kind ?? "" }, text));
  return element(
    "table",
    { class: className },
    element("caption", { class: "aside" }, caption),
    element("thead", {}, element("tr", {}, ...head)),
    element("tbody", {}, ...rows),
  );
}

function cell(content, kind = "") {
  return element("td", { class: kind }, ...[content].flat());
}

function rowHead(...content) {
  return element("th", { scope: "row" }, ...content);
}

function mark(point) {
  const kind = isSound(point) ? (point.dominated ? "dominated" : "sound") : "unsound";
  const glyph = { sound: "●", dominated: "○", unsound: "✕" }[kind];
  return element(
    "span",
    { class: `mark ${kind}` },
    element("span", { "aria-hidden": "true" }, `${glyph}\u00a0`),
    verdict(point),
  );
}

function pointsTable() {
  const several = strategies.length > 1;
  const heads = [["Point"], ["Design"], ...objectives.map((name) => [heading(name), "n"]), ["State"]];
  const rows = ordered().map((point) => {
    const button = element("button", { type: "button", class: "pick", "data-key": point.key }, point.key);
    button.setAttribute("aria-label", `Select point ${point.key}`);
    const values = objectives.map((name, index) => {
      const value = objective(point, index);
      return cell(number(value === null ? null : value * quantity(name).factor), "n");
    });
    return element(
      "tr",
      { "data-key": point.key },
      rowHead(button),
      cell([
        several ? strategyName(point.strategy ?? "") : "",
        element("span", { class: "label" }, titleOf(point)),
      ]),
      ...values,
      cell(mark(point)),
    );
  });
  return table("Points of the study", heads, rows, "points");
}

function casesTable(cases) {
  const name = objectives[0],
    first = objective(cases[0], 0);
  const shared = [...new Set(cases.flatMap((point) => Object.keys(point.metrics ?? {})))].filter(
    (metric) =>
      metric !== name &&
      (metric in requirements || ["structural_mass", "jitter_total", "modulus_margin"].includes(metric)),
  );
  const rows = cases.map((point) => {
    const value = objective(point, 0);
    const change = value !== null && first ? (100 * (value - first)) / Math.abs(first) : null;
    const active = (point.constraints ?? []).filter((constraint) => constraint.active);
    return element(
      "tr",
      { "data-key": point.key },
      rowHead(element("button", { type: "button", class: "pick", "data-key": point.key }, point.case)),
      cell(value === null ? missing : number(value * quantity(name).factor), "n"),
      cell(
        change === null || point === cases[0] ? missing : `${change > 0 ? "+" : ""}${number(change, 3)} %`,
        "n",
      ),
      ...shared.map((metric) => cell(metricNumber(metric, point.metrics?.[metric]), "n")),
      cell(active.map((constraint) => quantity(constraint.name).label).join(", ") || "none"),
      cell(mark(point)),
    );
  });
  return table(
    "Cases",
    [
      ["Case"],
      [heading(name), "n"],
      ["Change from first", "n"],
      ...shared.map((metric) => [heading(metric), "n"]),
      ["Active constraints"],
      ["State"],
    ],
    rows,
  );
}

function metricNumber(name, value) {
  const { factor } = quantity(name);
  const values = [value].flat().map((one) => number(typeof one === "number" ? one * factor : null));
  return values.join(", ");
}

function comparedStrategies() {
  const names = new Set((run.comparison ?? []).flatMap((row) => Object.keys(row)));
  names.delete("at");
  return [...names];
}

// How much less simultaneous design reaches than another strategy at the same first objective.
function gain(row, other) {
  const [ours, theirs] = [row.simultaneous, row[other]];
  return typeof ours === "number" && typeof theirs === "number" && theirs !== 0
    ? (100 * (theirs - ours)) / Math.abs(theirs)
    : null;
}

function comparisonTable() {
  const names = comparedStrategies(),
    others = names.filter((name) => name !== "simultaneous");
  const at = [...new Set(run.comparison.flatMap((row) => Object.keys(row.at ?? {})))];
  const target = run.comparison_objective ?? objectives[1] ?? objectives[0];
  const { unit } = quantity(target);
  const rows = run.comparison.map((row) =>
    element(
      "tr",
      {},
      ...at.map((name) => cell(metricNumber(name, row.at?.[name]), "n")),
      ...names.map((name) => cell(metricNumber(target, row[name]), "n")),
      ...others.map((name) => {
        const percent = gain(row, name);
        return cell(percent === null ? missing : `${number(percent, 3)} %`, "n strong");
      }),
    ),
  );
  const suffix = unit ? ` (${unit})` : "";
  return table(
    `${quantity(target).label} by strategy`,
    [
      ...at.map((name) => [
        `At ${quantity(name).label}${quantity(name).unit ? ` (${quantity(name).unit})` : ""}`,
        "n",
      ]),
      ...names.map((name) => [`${capital(strategyName(name))}${suffix}`, "n"]),
      ...others.map((name) => [`Gain over ${strategyName(name)}`, "n"]),
    ],
    rows,
  );
}

function gainFigure() {
  const others = comparedStrategies().filter((name) => name !== "simultaneous");
  const [axisName] = Object.keys(run.comparison[0]?.at ?? {});
  if (!axisName) return null;
  const { factor } = quantity(axisName);
  const data = others.flatMap((name, index) => {
    const known = run.comparison.filter((row) => gain(row, name) !== null);
    if (known.length < 2) return [];
    const [symbol, color] = STRATEGY_MARKS[(index + 1) % STRATEGY_MARKS.length];
    return [
      {
        x: known.map((row) => row.at[axisName] * factor),
        y: known.map((row) => gain(row, name)),
        mode: "lines+markers",
        name: plain(`over ${strategyName(name)}`),
        line: { color, width: 1.4 },
        marker: { symbol, color, size: 7 },
        hovertemplate: "%{x:.4g}<br>%{y:.3g} %",
      },
    ];
  });
  if (!data.length) return null;
  return {
    data,
    layout: layout({
      xaxis: axis(heading(axisName)),
      yaxis: axis("Gain (%)", { rangemode: "tozero" }),
      showlegend: true,
      margin: { l: 56, r: 14, t: 30, b: 44 },
    }),
  };
}

function comparisonText() {
  const target = run.comparison_objective ?? objectives[1] ?? objectives[0];
  const sentences = comparedStrategies()
    .filter((name) => name !== "simultaneous")
    .flatMap((name) => {
      const gains = run.comparison.map((row) => gain(row, name)).filter((value) => value !== null);
      if (!gains.length) return [];
      const [least, most] = [Math.min(...gains), Math.max(...gains)];
      const range = least === most ? `${number(most, 3)} %` : `${number(least, 3)} to ${number(most, 3)} %`;
      return [`Simultaneous design gains ${range} over ${strategyName(name)} design.`];
    });
  return [
    `${capital(quantity(target).label)} that each strategy reaches at the same point of the front.`,
    ...sentences,
  ].join(" ");
}

// A bar from zero to the value; left of zero for negative inertias, which mark nonminimum phase.
function signedBar(value, scale) {
  const outer = element("span", { class: "gauge", "aria-hidden": "true" });
  if (typeof value !== "number") return outer;
  const inner = element("span", { class: value < 0 ? "negative" : "positive" });
  const { low, high } = scale,
    width = high - low || 1;
  inner.style.left = `${(100 * ((value < 0 ? value : 0) - low)) / width}%`;
  inner.style.width = `${(100 * Math.abs(value)) / width}%`;
  outer.append(inner);
  return outer;
}

function modesTable(point) {
  const modes = detailOf(point).modes ?? [];
  if (!modes.length) return null;
  const inertias = modes
    .map((mode) => mode.effective_modal_reaction_inertia)
    .filter((value) => typeof value === "number");
  const scale = { low: Math.min(0, ...inertias), high: Math.max(0, ...inertias) };
  const shares = modes.some((mode) => typeof mode.jitter_share === "number");
  const percent = (share) => (typeof share === "number" ? 100 * share : null);
  const shown = modeShown(point);
  const rows = modes.map((mode, row) =>
    element(
      "tr",
      hasShape(point, row) ? { "data-mode": row, class: row === shown ? "current" : "" } : {},
      rowHead(hasShape(point, row) ? modeButton(mode, row === shown) : String(mode.index)),
      cell(number(mode.frequency_hz), "n"),
      cell(number(typeof mode.damping_ratio === "number" ? 100 * mode.damping_ratio : null, 3), "n"),
      cell(number(mode.effective_modal_reaction_inertia), "n"),
      cell(signedBar(mode.effective_modal_reaction_inertia, scale), "bars"),
      cell(number(mode.pole_zero_separation, 6), "n"),
      cell(number(mode.modal_inertia), "n"),
      ...(shares ? [cell(number(percent(mode.jitter_share), 3), "n")] : []),
    ),
  );
  return table(
    "Modes of the coupled system",
    [
      ["k"],
      ["Frequency (Hz)", "n"],
      ["Damping (%)", "n"],
      ["J̄ₖ", "n"],
      ["", "bars"],
      ["βₖ", "n"],
      ["Modal inertia (kg m²)", "n"],
      ...(shares ? [["Share of jitter² (%)", "n"]] : []),
    ],
    rows,
  );
}

function modeButton(mode, shown) {
  const state = { type: "button", class: "pick", "aria-pressed": String(shown) };
  return element("button", { ...state, "aria-label": `Draw the shape of mode ${mode.index}` }, String(mode.index));
}

function shapesHint(point) {
  const { shapes, modes = [] } = detailOf(point);
  if (shapes === null) return " The structure came without geometry: its mode shapes cannot be drawn.";
  const known = modes.filter((_, row) => hasShape(point, row)).length;
  if (!known) return "";
  const rest = known < modes.length ? " Rows without a button move nothing that is drawn, or the mirror least." : "";
  return ` Click a row, or step with the arrow keys, to draw its shape.${rest}`;
}

function modesCaption(point) {
  const values = (detailOf(point).modes ?? []).map((mode) => mode.effective_modal_reaction_inertia);
  const sum = values.reduce((total, value) => total + (value ?? 0), 0);
  return (
    "Modes of the coupled system: effective modal reaction inertia J̄ₖ (its bar runs left when negative), " +
    `pole-zero separation βₖ, modal inertia, and the share in the mean square jitter of the structural mode that the ` +
    `loop makes of it. These J̄ₖ sum to ${number(sum)}; all modes together, to one.` +
    (hasTwoAxes(point) ? " J̄ₖ is about the first axis, the mirror turning on its flexure about the second." : "") +
    shapesHint(point)
  );
}

function variablesTable(point) {
  const names = Object.keys(point.variables ?? {});
  if (!names.length) return null;
  const rows = names.map((name) => {
    const { unit, factor } = quantity(name);
    const values = scaled([point.variables[name]].flat(), factor);
    const few = values.length <= 4;
    const content = few
      ? [values.map((value) => number(value)).join(", ")]
      : [
          element(
            "details",
            {},
            element("summary", {}, `${number(Math.min(...values))} to ${number(Math.max(...values))}`),
            values.map((value) => number(value)).join(", "),
          ),
        ];
    return element(
      "tr",
      {},
      rowHead(capital(quantity(name).label)),
      cell(String(values.length), "n"),
      cell(content, "n values"),
      cell(unit, "unit"),
    );
  });
  return table("Design variables", [["Variable"], ["Values", "n"], ["", "n"], ["Unit"]], rows);
}

function judgement(met, words = met ? "met" : "exceeded") {
  if (met === null) return "";
  return element(
    "span",
    { class: `mark ${met ? "sound" : "unsound"}` },
    `${met ? "●" : "✕"}\u00a0${words}`,
  );
}

function metricsTable(point) {
  const names = Object.keys(point.metrics ?? {});
  if (!names.length) return null;
  const judged = names.some((name) => name in requirements);
  const rows = names.map((name) => {
    const value = point.metrics[name],
      most = requirements[name];
    const met = typeof value === "number" && typeof most === "number" ? value <= most + 1e-6 * Math.abs(most) : null;
    return element(
      "tr",
      {},
      rowHead(capital(quantity(name).label)),
      cell(metricNumber(name, value), "n"),
      cell(quantity(name).unit, "unit"),
      ...(judged
        ? [cell(typeof most === "number" ? [`≤ ${limit(name, most)} `, judgement(met)] : "", "judged")]
        : []),
    );
  });
  return table("Metrics", [["Metric"], ["Value", "n"], ["Unit"], ...(judged ? [["Requirement"]] : [])], rows);
}
