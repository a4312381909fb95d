// The jitter budget of one point: by source, by mode, and where in frequency it comes from.

function angle() {
  const known = run.quantities?.jitter_total ?? run.quantities?.step_offset;
  return known ? { unit: unitText(known.unit), factor: known.factor ?? 1 } : { unit: "µrad", factor: 1e6 };
}

function sourceName(name) {
  return name.replaceAll("_", " ");
}

// A requirement on the total runs across; one on a source marks its own row.
function budgetLines(rows, limits, factor) {
  const [shapes, annotations] = [[], []];
  rows.forEach(([name], index) => {
    if (name === "total" || !(limits[index] > 0)) return;
    const line = levelLine(limits[index] * factor, "y", "");
    shapes.push({ ...line.shape, yref: "y", y0: index - 0.42, y1: index + 0.42 });
    annotations.push({
      ...line.note,
      text: `≤ ${plain(limit(`jitter_${name}`, limits[index]))}`,
      yref: "y",
      y: index + 0.42,
      yanchor: "bottom",
      xanchor: "center",
      textangle: 0,
    });
  });
  if (limits[0] > 0) {
    const line = levelLine(limits[0] * factor, "y", `requirement ${limit("jitter_total", limits[0])}`);
    shapes.push(line.shape);
    annotations.push({ ...line.note, yanchor: "bottom", textangle: 0, xanchor: "right" });
  }
  return { shapes, annotations };
}

function jitterFigure(point) {
  const jitter = detailOf(point).jitter;
  const sources = Object.keys(jitter ?? {}).filter((name) => typeof jitter[name] === "number");
  if (!sources.length) return null;
  const { unit, factor } = angle();
  const total = point.metrics?.jitter_total ?? Math.hypot(...sources.map((name) => jitter[name]));
  // The first row stands at the bottom of a bar chart.
  const rows = [...sources.map((name) => [name, jitter[name]]), ["total", total]].reverse();
  const where = rows.map((_, index) => index);
  const limits = rows.map(([name]) => requirements[name === "total" ? "jitter_total" : `jitter_${name}`]);
  const labels = rows.map(([name, value]) => {
    const share = name === "total" ? "" : `, ${number(100 * (value / total) ** 2, 2)} %`;
    const size = plain(withUnit(number(value * factor, 3), unit));
    return `<b>${plain(sourceName(name))}</b><br>${size}${share}`;
  });
  const furthest = Math.max(...rows.map(([, value]) => value), ...limits.filter((most) => most > 0));
  return {
    data: [
      {
        type: "bar",
        orientation: "h",
        y: where,
        x: rows.map(([, value]) => value * factor),
        width: 0.62,
        marker: {
          color: rows.map(([name]) =>
            name === "total" ? INK : SOURCES[sources.indexOf(name) % SOURCES.length],
          ),
        },
        hoverinfo: "skip",
      },
    ],
    layout: layout({
      xaxis: axis(`Line-of-sight jitter, rms (${unit})`, { range: [0, 1.06 * factor * furthest] }),
      yaxis: axis("", {
        tickvals: where,
        ticktext: labels,
        ticks: "",
        showgrid: false,
        range: [-0.6, rows.length - 0.4],
      }),
      ...budgetLines(rows, limits, factor),
      margin: { l: 70, r: 14, t: 24, b: 44 },
    }),
  };
}

// One curve for each source in the colors of the budget, and their total in ink.
function sourceCurves(table, factor, hover) {
  const names = Object.keys(table).filter((name) => !["frequency_hz", "total"].includes(name));
  const curve = (name, line) => ({
    x: table.frequency_hz,
    y: scaled(table[name], factor),
    mode: "lines",
    name: plain(sourceName(name)),
    line,
    hovertemplate: `%{x:.4g} Hz<br>${hover}`,
  });
  const curves = names.map((name, index) =>
    curve(name, { color: SOURCES[index % SOURCES.length], dash: DASHES[index % DASHES.length], width: 1.6 }),
  );
  return table.total && names.length > 1 ? [...curves, curve("total", { color: INK, width: 2.4 })] : curves;
}

function cumulativeFigure(point) {
  const { cumulative } = detailOf(point);
  if (!cumulative?.frequency_hz) return null;
  const { unit, factor } = angle();
  const most = requirements.jitter_total;
  const line = most > 0 ? levelLine(most * factor, "x", `requirement ${limit("jitter_total", most)}`) : null;
  const allowed = run.requirement_line;
  const allowance = {
    x: allowed?.frequency_hz,
    y: scaled(allowed?.rms ?? [], factor),
    mode: "lines",
    name: "required",
    line: { color: VERMILION, dash: "dash", width: 1.6 },
    hovertemplate: `%{x:.4g} Hz<br>at most %{y:.4g} ${unit}`,
  };
  const curves = sourceCurves(cumulative, factor, `%{y:.4g} ${unit}`);
  return {
    data: allowed ? [...curves, allowance, ...excessTrace(point, factor)] : curves,
    layout: layout({
      xaxis: decades("Frequency (Hz)"),
      yaxis: axis(`Cumulative jitter, rms (${unit})`, { rangemode: "tozero" }),
      shapes: line ? [line.shape] : [],
      annotations: line ? [{ ...line.note, x: 0, xanchor: "left" }] : [],
      showlegend: true,
      margin: { l: 60, r: 14, t: 34, b: 44 },
    }),
  };
}

// A verdict on the requirement line in color and words, next to the curve that it is of.
function lineVerdict(point) {
  const line = point.requirement_line;
  if (!run.requirement_line || typeof line?.met !== "boolean") return [];
  const { unit, factor } = angle();
  const size = (value) => withUnit(number(value * factor), unit);
  const [reached, allowed, apart] = [line.reached, line.allowed, Math.abs(line.excess)].map(size);
  const where = `at ${number(line.frequency_hz)} Hz`;
  const words = line.met
    ? `closest ${where}, with ${reached} of ${allowed}.`
    : `most ${where}, by ${apart}: ${reached} where ${allowed} is allowed.`;
  const verdict = line.met ? "Keeps below the requirement line" : "Exceeds the requirement line";
  return [" Dashed: required. ", judgement(line.met, verdict), `, ${words} The line is judged; no optimization knows of it.`];
}

function lineMark(point) {
  const met = point.requirement_line?.met;
  return typeof met === "boolean" ? judgement(met) : "not judged";
}

// Where the line is exceeded most, from what is allowed up to what is reached.
function excessTrace(point, factor) {
  const line = point.requirement_line;
  if (!run.requirement_line || line?.met !== false) return [];
  const mark = { symbol: ["line-ew-open", "x"], size: 9, color: VERMILION, line: { width: 2 } };
  return [
    {
      x: [line.frequency_hz, line.frequency_hz],
      y: scaled([line.allowed, line.reached], factor),
      mode: "lines+markers",
      name: "worst excess",
      line: { color: VERMILION, width: 2 },
      marker: mark,
      hoverinfo: "skip",
    },
  ];
}

function spectrumFigure(point) {
  const { spectrum } = detailOf(point);
  if (!spectrum?.frequency_hz) return null;
  const { unit, factor } = angle();
  // The curves end six decades below the peak, and what ends there is not to look like a floor.
  const peak = Math.log10(Math.max(...spectrum.total) * factor);
  return {
    data: sourceCurves(spectrum, factor, `%{y:.3g} ${unit}/√Hz`),
    layout: layout({
      xaxis: decades("Frequency (Hz)"),
      yaxis: decades(`Line of sight (${unit}/√Hz)`, {
        exponentformat: "power",
        tickformat: "",
        range: [peak - 5.95, peak + 0.3],
      }),
      showlegend: true,
      margin: { l: 60, r: 14, t: 34, b: 44 },
    }),
  };
}

const MODE_SOURCES = [VERMILION, BLUE, GREEN, PURPLE, ORANGE];

function modeName(mode) {
  return `${number(mode.frequency_hz, 3)} Hz`;
}

function isWorthNaming({ share }) {
  return Math.abs(share) >= 0.002;
}

function byModeFigure(point) {
  const found = detailOf(point).by_mode;
  if (!found) return null;
  const { unit, factor } = angle();
  const total = point.metrics?.jitter_total;
  const drawn = found.modes.slice(0, 6).filter(isWorthNaming);
  const others = found.other_modes + found.modes.slice(drawn.length).reduce((sum, mode) => sum + mode.share, 0);
  const rest = found.count - drawn.length;
  const rows = [
    ...drawn.map((mode, index) => [modeName(mode), mode.share, MODE_SOURCES[index] ?? SKY]),
    ...(rest ? [[`${rest} others`, others, "#9aa1aa"]] : []),
    ["mirror, loop", found.loop, INK],
  ].reverse();
  const where = rows.map((_, index) => index);
  // A share is a part of the mean square; its root has the unit of the budget.
  const root = (share) =>
    typeof total === "number"
      ? `${withUnit(number(Math.sign(share) * Math.sqrt(Math.abs(share)) * total * factor, 3), unit)}, `
      : "";
  const shares = rows.map(([, share]) => 100 * share);
  const [least, most] = [Math.min(0, ...shares), Math.max(0, ...shares)];
  return {
    data: [
      {
        type: "bar",
        orientation: "h",
        y: where,
        x: shares,
        width: 0.62,
        marker: { color: rows.map(([, , color]) => color) },
        hoverinfo: "skip",
      },
      {
        mode: "text",
        y: where,
        x: shares.map((share) => Math.max(share, 0)),
        text: rows.map(([, share]) => plain(` ${root(share)}${number(100 * share, 2)} %`)),
        textposition: "middle right",
        cliponaxis: false,
        hoverinfo: "skip",
      },
    ],
    layout: layout({
      // Right of the bars there is room for what is written there.
      xaxis: axis("Share of the mean square (%)", {
        range: [1.05 * least, most + 0.75 * (most - least)],
        zeroline: true,
        zerolinecolor: MUTED,
      }),
      yaxis: axis("", {
        tickvals: where,
        ticktext: rows.map(([name]) => `<b>${plain(name)}</b>`),
        ticks: "",
        showgrid: false,
        range: [-0.6, rows.length - 0.4],
      }),
      margin: { l: 70, r: 14, t: 12, b: 44 },
    }),
  };
}

function modeCurvesFigure(point) {
  const found = detailOf(point).by_mode;
  if (!found?.cumulative?.frequency_hz) return null;
  const curve = (name, label, line) => ({
    x: found.cumulative.frequency_hz,
    y: scaled(found.cumulative[name], 100),
    mode: "lines",
    name: plain(label),
    line,
    hovertemplate: "%{x:.4g} Hz<br>%{y:.3g} %",
  });
  const drawn = found.modes.slice(0, 5).filter(isWorthNaming);
  const style = (index) => ({ color: MODE_SOURCES[index], dash: DASHES[index % DASHES.length], width: 1.6 });
  return {
    data: [
      ...drawn.map((mode, index) => curve(`mode ${index + 1}`, modeName(mode), style(index))),
      ...(found.count > 5 ? [curve("other modes", "others", { color: "#9aa1aa", width: 1.6 })] : []),
      curve("loop", "mirror, loop", { color: INK, width: 2, dash: "dot" }),
    ],
    layout: layout({
      xaxis: decades("Frequency (Hz)"),
      yaxis: axis("Cumulative share (%)"),
      showlegend: true,
      margin: { l: 60, r: 14, t: 34, b: 44 },
    }),
  };
}
