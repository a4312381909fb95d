// Jitter, step response and convergence of one point. Each figure takes the point and returns traces and
// layout, or null when it has no data.

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
    const size = plain(withUnit(number(value * factor, 3), unit));
    return `<b>${plain(name.replaceAll("_", " "))}</b><br>${size}${share}`;
  });
  const limits = rows.map(([name]) => requirements[name === "total" ? "jitter_total" : `jitter_${name}`]);
  const data = [
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
  ];
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
      xaxis: axis(`Line-of-sight jitter, rms (${unit})`, {
        range: [0, 1.06 * factor * Math.max(...furthest)],
      }),
      yaxis: axis("", {
        tickvals: where,
        ticktext: labels,
        ticks: "",
        showgrid: false,
        range: [-0.6, rows.length - 0.4],
      }),
      shapes,
      annotations,
      margin: { l: 70, r: 14, t: 24, b: 44 },
    }),
  };
}

function cumulativeFigure(point) {
  const cumulative = point.detail?.cumulative;
  if (!cumulative?.frequency_hz) return null;
  const { unit, factor } = angle();
  const names = Object.keys(cumulative).filter((name) => !["frequency_hz", "total"].includes(name));
  const curve = (name, style) => ({
    x: cumulative.frequency_hz,
    y: scaled(cumulative[name], factor),
    mode: "lines",
    name: plain(name.replaceAll("_", " ")),
    line: style,
    hovertemplate: `%{x:.4g} Hz<br>%{y:.4g} ${unit}`,
  });
  const data = names.map((name, index) =>
    curve(name, {
      color: SOURCES[index % SOURCES.length],
      dash: DASHES[index % DASHES.length],
      width: 1.6,
    }),
  );
  if (cumulative.total) data.push(curve("total", { color: INK, width: 2.4 }));
  const most = requirements.jitter_total;
  const line = most > 0 ? levelLine(most * factor, "x", `requirement ${limit("jitter_total", most)}`) : null;
  return {
    data,
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

function stepFigure(point) {
  const step = point.detail?.step;
  if (!step) return null;
  const { unit, factor } = angle();
  const [shapes, annotations] = [[], []];
  if (step.window) {
    const [start, end] = step.window.map((time) => 1e3 * time);
    shapes.push({
      type: "rect",
      x0: start,
      x1: end,
      y0: 0,
      y1: 1,
      yref: "y domain",
      fillcolor: SKY,
      opacity: 0.18,
      line: { width: 0 },
      layer: "below",
    });
    annotations.push({
      x: (start + end) / 2,
      y: 0,
      yref: "y domain",
      yanchor: "bottom",
      showarrow: false,
      font: { size: 11, color: MUTED },
      text: `window ${trimmed(start)} to ${trimmed(end)} ms`,
    });
  }
  if (typeof step.command === "number") {
    const line = levelLine(
      step.command * factor,
      "x",
      `command ${withUnit(trimmed(step.command * factor), unit)}`,
    );
    shapes.push({ ...line.shape, line: { color: MUTED, width: 1, dash: "dash" } });
    annotations.push({ ...line.note, font: { size: 11, color: MUTED } });
  }
  return {
    data: [
      {
        x: scaled(step.time_s, 1e3),
        y: scaled(step.response, factor),
        mode: "lines",
        line: { color: BLUE, width: 1.6 },
        hovertemplate: `%{x:.4g} ms<br>%{y:.4g} ${unit}<extra></extra>`,
      },
    ],
    layout: layout({ xaxis: axis("Time (ms)"), yaxis: axis(`Line of sight (${unit})`), shapes, annotations }),
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
      ...(valued
        ? [
            {
              ...curve,
              y: history.map(([, value]) => value),
              hovertemplate: "iteration %{x}<br>objective %{y:.6g}<extra></extra>",
            },
          ]
        : []),
      {
        ...curve,
        y: history.map(([, , value]) => (value > 0 ? value : null)),
        yaxis: "y2",
        line: { color: ORANGE, width: 1.5 },
        marker: { size: 5, symbol: "diamond" },
        hovertemplate: "iteration %{x}<br>infeasibility %{y:.3g}<extra></extra>",
      },
    ],
    layout: layout({
      xaxis: axis("Iteration", { anchor: "y2", mirror: "all" }),
      ...(valued ? { yaxis: axis("Objective", { domain: [0.54, 1] }) } : {}),
      yaxis2: axis("Infeasibility", { domain: [0, valued ? 0.46 : 1], type: "log", nticks: 5 }),
      margin: { l: 64, r: 14, t: 12, b: 44 },
    }),
  };
}
