// The figures of one point. Each takes the point and returns traces and layout, or null when it has no data.

const INK = "#1b1f24", MUTED = "#5b6470", GRID = "#e6e9ed", PAPER = "#ffffff";
const BLUE = "#0072b2", VERMILION = "#d55e00", GREEN = "#009e73", ORANGE = "#e69f00", PURPLE = "#b0578d", SKY = "#56b4e9";
const SOURCES = [BLUE, ORANGE, GREEN, PURPLE, SKY, "#7f6a00"];
const DASHES = ["solid", "dash", "dot", "dashdot", "longdash", "longdashdot"];
const FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "Liberation Sans", sans-serif';

// plotly reads a few tags in its texts; what a user wrote must stay text.
function plain(text) {
  return String(text).replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
}

function axis(title, more = {}) {
  return {
    title: { text: plain(title), standoff: 8 }, showline: true, mirror: true, linecolor: MUTED, linewidth: 1,
    ticks: "inside", tickcolor: MUTED, ticklen: 4, gridcolor: GRID, zeroline: false, automargin: true,
    exponentformat: "e", ...more,
  };
}

function decades(title, more = {}) {
  return axis(title, { type: "log", dtick: 1, tickformat: "~g", minor: { ticks: "inside", ticklen: 2, tickcolor: MUTED }, ...more });
}

function layout(more) {
  return {
    font: { family: FONT, size: 12, color: INK }, paper_bgcolor: PAPER, plot_bgcolor: PAPER, autosize: true,
    margin: { l: 56, r: 14, t: 12, b: 44 }, hovermode: "closest", showlegend: false,
    hoverlabel: { bgcolor: PAPER, bordercolor: MUTED, font: { family: FONT, size: 12, color: INK }, align: "left" },
    legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", font: { size: 11.5 } },
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
    ...more,
  };
}

function levelLine(value, across, label, more = {}) {
  const line = { type: "line", line: { color: VERMILION, width: 1.5, dash: "dash" }, ...more };
  const note = { text: plain(label), showarrow: false, font: { size: 11, color: "#a64500" }, bgcolor: "rgba(255,255,255,.8)" };
  if (across === "x") {
    return {
      shape: { ...line, x0: 0, x1: 1, xref: "x domain", y0: value, y1: value },
      note: { ...note, x: 1, xref: "x domain", xanchor: "right", y: value, yanchor: "bottom" },
    };
  }
  return {
    shape: { ...line, y0: 0, y1: 1, yref: "y domain", x0: value, x1: value },
    note: { ...note, y: 1, yref: "y domain", yanchor: "top", x: value, xanchor: "left", textangle: 90 },
  };
}

// Annotations, unlike shapes, want the logarithm of a position on a logarithmic axis.
function placed(line, key, logarithmic) {
  return logarithmic ? { ...line.note, [key]: Math.log10(line.note[key]) } : line.note;
}

function decibels(values) {
  return values.map((value) => (value > 0 ? 20 * Math.log10(value) : null));
}

function turns(values) {
  const known = values.filter((value) => typeof value === "number");
  const span = Math.max(...known) - Math.min(...known);
  return span > 1440 ? 720 : span > 720 ? 360 : span > 360 ? 180 : 90;
}

// −180° and its like within the range of an unwrapped phase.
function critical(phases) {
  const known = phases.filter((value) => typeof value === "number");
  const least = Math.ceil((Math.min(...known) - 180) / 360), most = Math.floor((Math.max(...known) - 180) / 360);
  return Array.from({ length: Math.max(0, most - least + 1) }, (_, index) => 180 + 360 * (least + index));
}

function bodeFigure(point) {
  const bode = point.detail?.bode;
  if (!bode) return null;
  const curve = { x: bode.frequency_hz, mode: "lines", line: { color: BLUE, width: 1.5 } };
  const shapes = [levelLine(0, "x", "").shape, ...critical(bode.loop_phase_deg).map((phase) => ({ ...levelLine(phase, "x", "").shape, yref: "y2" }))];
  shapes.forEach((shape) => Object.assign(shape.line, { color: MUTED, width: 1, dash: "dot" }));
  const crossover = point.metrics?.crossover, annotations = [];
  if (typeof crossover === "number" && crossover > 0) {
    const line = levelLine(crossover / (2 * Math.PI), "y", `crossover ${number(crossover / (2 * Math.PI), 3)} Hz`);
    shapes.push({ ...line.shape, yref: "paper", line: { color: MUTED, width: 1, dash: "dash" } });
    annotations.push({ ...placed(line, "x", true), font: { size: 11, color: MUTED } });
  }
  return {
    data: [
      { ...curve, y: decibels(bode.loop_magnitude), hovertemplate: "%{x:.4g} Hz<br>|L| %{y:.2f} dB<extra></extra>" },
      { ...curve, y: bode.loop_phase_deg, yaxis: "y2", hovertemplate: "%{x:.4g} Hz<br>phase %{y:.1f}°<extra></extra>" },
    ],
    layout: layout({
      xaxis: decades("Frequency (Hz)", { anchor: "y2", mirror: "all" }),
      yaxis: axis("|L| (dB)", { domain: [0.46, 1] }),
      yaxis2: axis("Phase of L (°)", { domain: [0, 0.42], dtick: turns(bode.loop_phase_deg) }),
      shapes, annotations,
    }),
  };
}

function sensitivityFigure(point) {
  const bode = point.detail?.bode;
  if (!bode?.sensitivity) return null;
  const shapes = [], annotations = [];
  const margin = point.metrics?.modulus_margin;
  const least = (point.constraints ?? []).find((constraint) => constraint.name === "modulus_margin")?.lower;
  const levels = [[margin, `1/modulus margin = ${number(1 / margin, 3)}`, { color: MUTED, width: 1, dash: "dot" }],
    [least, `required: at most ${trimmed(1 / least, 3)}`, { color: VERMILION, width: 1.5, dash: "dash" }]];
  levels.filter(([value]) => value > 0).forEach(([value, label, style], index) => {
    const line = levelLine(-20 * Math.log10(value), "x", label);
    shapes.push({ ...line.shape, line: style });
    const side = index ? {} : { x: 0, xanchor: "left", yanchor: "top", font: { size: 11, color: MUTED } };
    annotations.push({ ...line.note, bgcolor: "rgba(255,255,255,0)", ...side });
  });
  const curve = (values, name, style) => ({
    x: bode.frequency_hz, y: decibels(values), name, mode: "lines", line: { width: 1.6, ...style },
    hovertemplate: `%{x:.4g} Hz<br>${name} %{y:.2f} dB<extra></extra>`,
  });
  // An integrator sends |S| far down at low frequency, where nothing is decided.
  const peak = Math.max(...[bode.sensitivity, bode.complementary_sensitivity ?? []].flatMap(decibels), 6);
  return {
    data: [
      curve(bode.sensitivity, "|S|", { color: BLUE }),
      ...(bode.complementary_sensitivity
        ? [curve(bode.complementary_sensitivity, "|T|", { color: ORANGE, dash: "dash" })] : []),
    ],
    layout: layout({
      xaxis: decades("Frequency (Hz)"), yaxis: axis("Magnitude (dB)", { range: [-60, peak + 8] }), shapes, annotations, showlegend: true,
      margin: { l: 56, r: 14, t: 34, b: 44 },
    }),
  };
}

function angle() {
  const known = run.quantities?.jitter_total ?? run.quantities?.step_offset;
  return known ? { unit: unitText(known.unit), factor: known.factor ?? 1 } : { unit: "µrad", factor: 1e6 };
}

function jitterFigure(point) {
  const jitter = point.detail?.jitter;
  const sources = Object.keys(jitter ?? {}).filter((name) => typeof jitter[name] === "number");
  if (!sources.length) return null;
  const { unit, factor } = angle();
  const total = point.metrics?.jitter_total ?? Math.hypot(...sources.map((name) => jitter[name]));
  // The first row stands at the bottom of a bar chart.
  const rows = [...sources.map((name) => [name, jitter[name]]), ["total", total]].reverse();
  const where = rows.map((_, index) => index);
  const labels = rows.map(([name, value]) => {
    const share = name === "total" ? "" : `, ${number(100 * (value / total) ** 2, 2)} %`;
    return `<b>${plain(name.replaceAll("_", " "))}</b><br>${plain(withUnit(number(value * factor, 3), unit))}${share}`;
  });
  const limits = rows.map(([name]) => requirements[name === "total" ? "jitter_total" : `jitter_${name}`]);
  const data = [{
    type: "bar", orientation: "h", y: where, x: rows.map(([, value]) => value * factor), width: 0.62,
    marker: { color: rows.map(([name]) => (name === "total" ? INK : SOURCES[sources.indexOf(name) % SOURCES.length])) },
    hoverinfo: "skip",
  }];
  const [furthest, shapes, annotations] = [[...rows.map(([, value]) => value), limits[0] ?? 0], [], []];
  rows.forEach(([name], index) => {
    if (name === "total" || !(limits[index] > 0)) return;
    const line = levelLine(limits[index] * factor, "y", "");
    shapes.push({ ...line.shape, yref: "y", y0: index - 0.4, y1: index + 0.4 });
  });
  if (limits[0] > 0) {
    const line = levelLine(limits[0] * factor, "y", `requirement ${limit("jitter_total", limits[0])}`);
    shapes.push(line.shape);
    annotations.push({ ...line.note, yanchor: "bottom", textangle: 0, xanchor: "right" });
  }
  return {
    data,
    layout: layout({
      xaxis: axis(`Line-of-sight jitter, rms (${unit})`, { range: [0, 1.06 * factor * Math.max(...furthest)] }),
      yaxis: axis("", {
        tickvals: where, ticktext: labels, ticks: "", showgrid: false,
        range: [-0.6, rows.length - 0.4],
      }),
      shapes, annotations, margin: { l: 70, r: 14, t: 24, b: 44 },
    }),
  };
}

function cumulativeFigure(point) {
  const cumulative = point.detail?.cumulative;
  if (!cumulative?.frequency_hz) return null;
  const { unit, factor } = angle();
  const names = Object.keys(cumulative).filter((name) => !["frequency_hz", "total"].includes(name));
  const curve = (name, style) => ({
    x: cumulative.frequency_hz, y: scaled(cumulative[name], factor), mode: "lines", name: plain(name.replaceAll("_", " ")),
    line: style, hovertemplate: `%{x:.4g} Hz<br>%{y:.4g} ${unit}`,
  });
  const data = names.map((name, index) => curve(name, {
    color: SOURCES[index % SOURCES.length], dash: DASHES[index % DASHES.length], width: 1.6,
  }));
  if (cumulative.total) data.push(curve("total", { color: INK, width: 2.4 }));
  const most = requirements.jitter_total;
  const line = most > 0 ? levelLine(most * factor, "x", `requirement ${limit("jitter_total", most)}`) : null;
  return {
    data,
    layout: layout({
      xaxis: decades("Frequency (Hz)"), yaxis: axis(`Cumulative jitter, rms (${unit})`, { rangemode: "tozero" }),
      shapes: line ? [line.shape] : [], annotations: line ? [{ ...line.note, x: 0, xanchor: "left" }] : [],
      showlegend: true, margin: { l: 60, r: 14, t: 34, b: 44 },
    }),
  };
}

function stepFigure(point) {
  const step = point.detail?.step;
  if (!step) return null;
  const { unit, factor } = angle();
  const [shapes, annotations] = [[], []];
  if (step.window) {
    const [start, end] = step.window.map((time) => 1e3 * time);
    shapes.push({
      type: "rect", x0: start, x1: end, y0: 0, y1: 1, yref: "y domain", fillcolor: SKY, opacity: 0.18,
      line: { width: 0 }, layer: "below",
    });
    annotations.push({
      x: (start + end) / 2, y: 0, yref: "y domain", yanchor: "bottom", showarrow: false, font: { size: 11, color: MUTED },
      text: `window ${trimmed(start)} to ${trimmed(end)} ms`,
    });
  }
  if (typeof step.command === "number") {
    const line = levelLine(step.command * factor, "x", `command ${withUnit(trimmed(step.command * factor), unit)}`);
    shapes.push({ ...line.shape, line: { color: MUTED, width: 1, dash: "dash" } });
    annotations.push({ ...line.note, font: { size: 11, color: MUTED } });
  }
  return {
    data: [{
      x: scaled(step.time_s, 1e3), y: scaled(step.response, factor), mode: "lines", line: { color: BLUE, width: 1.6 },
      hovertemplate: `%{x:.4g} ms<br>%{y:.4g} ${unit}<extra></extra>`,
    }],
    layout: layout({ xaxis: axis("Time (ms)"), yaxis: axis(`Line of sight (${unit})`), shapes, annotations }),
  };
}

function polesFigure(point) {
  const poles = (point.detail?.poles ?? []).filter(([re, im]) => im >= 0 && Math.hypot(re, im) > 0);
  if (!poles.length) return null;
  const group = (chosen, name, marker, word) => ({
    x: chosen.map(([re, im]) => Math.hypot(re, im) / (2 * Math.PI)),
    // An undamped pole has no place on a logarithmic axis; it stands at its lower end.
    y: chosen.map(([re, im]) => Math.max(Math.abs(re) / Math.hypot(re, im), 1e-6)),
    mode: "markers", name, marker: { size: 8, line: { width: 1.6, color: marker.color }, ...marker },
    hovertemplate: `%{x:.5g} Hz<br>${word} %{y:.3g}<extra></extra>`,
  });
  const growing = poles.filter(([re]) => re >= 0);
  const data = [group(poles.filter(([re]) => re < 0), "decaying", { symbol: "x-thin-open", color: BLUE }, "damping ratio")];
  if (growing.length) data.push(group(growing, "growing (unstable)", { symbol: "triangle-up", color: VERMILION, size: 11 }, "growth ratio"));
  return {
    data,
    layout: layout({
      xaxis: decades("Natural frequency (Hz)"), yaxis: decades("Damping ratio"), showlegend: growing.length > 0,
      margin: { l: 56, r: 14, t: growing.length ? 34 : 12, b: 44 },
    }),
  };
}

function historyFigure(point) {
  const history = point.history ?? [];
  if (history.length < 2) return null;
  const x = history.map(([iteration]) => iteration);
  const valued = history.some(([, value]) => typeof value === "number");
  const curve = { x, mode: "lines+markers", marker: { size: 4 }, line: { color: BLUE, width: 1.5 } };
  return {
    data: [
      ...(valued ? [{ ...curve, y: history.map(([, value]) => value), hovertemplate: "iteration %{x}<br>objective %{y:.6g}<extra></extra>" }] : []),
      {
        ...curve, y: history.map(([, , value]) => (value > 0 ? value : null)), yaxis: "y2",
        line: { color: ORANGE, width: 1.5 }, marker: { size: 5, symbol: "diamond" },
        hovertemplate: "iteration %{x}<br>infeasibility %{y:.3g}<extra></extra>",
      },
    ],
    layout: layout({
      xaxis: axis("Iteration", { anchor: "y2", mirror: "all" }), ...(valued ? { yaxis: axis("Objective", { domain: [0.54, 1] }) } : {}),
      yaxis2: axis("Infeasibility", { domain: [0, valued ? 0.46 : 1], type: "log", nticks: 5 }), margin: { l: 64, r: 14, t: 12, b: 44 },
    }),
  };
}
