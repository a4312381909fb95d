// Step response and convergence of one point. Each figure takes the point and returns traces and layout, or null
// when it has no data.

function stepFigure(point) {
  const { step } = detailOf(point);
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

// The error within the window, which the whole response is too large to show.
function windowFigure(point) {
  const { step } = detailOf(point);
  if (!step?.window_time_s) return null;
  const { unit, factor } = angle();
  const small = unit === "µrad" && Math.max(...step.window_error.map(Math.abs)) * factor < 1;
  const [shownUnit, more] = small ? ["nrad", 1e3 * factor] : [unit, factor];
  const level = (value, label, line) => {
    const made = levelLine(value * more, "x", label);
    return { shape: { ...made.shape, line }, note: { ...made.note, font: { size: 11, color: MUTED } } };
  };
  const value = (error) => withUnit(number(error * more, 3), shownUnit);
  const dotted = { color: MUTED, width: 1, dash: "dot" };
  const lines = [
    level(step.mean, `mean ${value(step.mean)}`, { color: MUTED, width: 1, dash: "dash" }),
    level(step.mean + step.rms, `mean ± rms, rms ${value(step.rms)}`, dotted),
    level(step.mean - step.rms, "", dotted),
  ];
  const most = requirements.step_rms;
  if (most > 0) {
    lines.push(
      ...[1, -1].map((sign) => {
        const made = levelLine((step.mean + sign * most) * more, "x", sign > 0 ? `required rms ${value(most)}` : "");
        return { ...made, note: { ...made.note, x: 0, xanchor: "left" } };
      }),
    );
  }
  return {
    data: [
      {
        x: scaled(step.window_time_s, 1e3),
        y: scaled(step.window_error, more),
        mode: "lines",
        line: { color: BLUE, width: 1.4 },
        hovertemplate: `%{x:.5g} ms<br>%{y:.4g} ${shownUnit}<extra></extra>`,
      },
    ],
    layout: layout({
      xaxis: axis("Time (ms)", { range: step.window.map((time) => 1e3 * time) }),
      yaxis: axis(`Error in the window (${shownUnit})`),
      shapes: lines.map((line) => line.shape),
      annotations: lines.filter((line) => line.note.text).map((line) => line.note),
    }),
  };
}

// The objective in its unit where the solver's last value is that of the design, else as the solver sees it.
function historyObjective(point, values) {
  const name = point.objective;
  const reached = point.metrics?.[name];
  const last = values.findLast((value) => typeof value === "number");
  const same = typeof reached === "number" && Math.abs(last - reached) <= 1e-3 * Math.abs(reached);
  if (!same) return { title: "Objective", factor: 1 };
  const { unit, factor } = quantity(name);
  return { title: unit ? `Objective (${unit})` : "Objective", factor };
}

function historyCaption(point) {
  const aim = Object.hasOwn(run.quantities ?? {}, point.objective ?? "") ? ` (${quantity(point.objective).label})` : "";
  return `Convergence: objective${aim} and largest constraint violation by iteration.`;
}

function historyFigure(point) {
  const history = point.history ?? [];
  if (history.length < 2) return null;
  const x = history.map(([iteration]) => iteration);
  const values = history.map(([, value]) => value);
  const valued = values.some((value) => typeof value === "number");
  const { title, factor } = historyObjective(point, values);
  const curve = { x, mode: "lines+markers", marker: { size: 4 }, line: { color: BLUE, width: 1.5 } };
  const objectiveCurve = {
    ...curve,
    y: scaled(values, factor),
    hovertemplate: "iteration %{x}<br>objective %{y:.6g}<extra></extra>",
  };
  return {
    data: [
      ...(valued ? [objectiveCurve] : []),
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
      ...(valued ? { yaxis: axis(title, { domain: [0.54, 1] }) } : {}),
      yaxis2: axis("Infeasibility", {
        domain: [0, valued ? 0.46 : 1],
        type: "log",
        nticks: 5,
        exponentformat: "power",
      }),
      margin: { l: 64, r: 14, t: 12, b: 44 },
    }),
  };
}
