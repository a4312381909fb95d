// The loop of one point: Bode plot, sensitivities and closed-loop poles.

// A sampled loop is judged as it is; some figures have the continuous model that it was designed on.
function ofModel(text) {
  return (point) => (detailOf(point).sampling_rate_hz ? `${text} Of the continuous model of the sampled loop.` : text);
}

function asSampled(text, more = ", up to the Nyquist frequency") {
  return (point) => {
    const rate = detailOf(point).sampling_rate_hz;
    return rate ? `${text} Of the loop as sampled at ${number(rate, 4)}\u00a0Hz${more}.` : text;
  };
}

// Of a mirror with two axes, each loop is looked at with the other one closed.
function hasTwoAxes(point) {
  return Boolean(detailOf(point).bode?.second_axis_loop_magnitude);
}

function decibels(values) {
  return values.map((value) => (value > 0 ? 20 * Math.log10(value) : null));
}

function turns(values) {
  const known = values.filter((value) => typeof value === "number");
  const span = Math.max(...known) - Math.min(...known);
  return span > 1440 ? 720 : span > 720 ? 360 : span > 360 ? 180 : 90;
}

// −180° and its like within the range of a continuous phase.
function critical(phases) {
  const known = phases.filter((value) => typeof value === "number");
  const least = Math.ceil((Math.min(...known) - 180) / 360),
    most = Math.floor((Math.max(...known) - 180) / 360);
  return Array.from({ length: Math.max(0, most - least + 1) }, (_, index) => 180 + 360 * (least + index));
}

function bodeFigure(point) {
  const { bode } = detailOf(point);
  if (!bode) return null;
  const phases = bode.loop_phase_deg;
  const curve = { x: bode.frequency_hz, mode: "lines", line: { color: BLUE, width: 1.5 } };
  const shapes = [
    levelLine(0, "x", "").shape,
    ...(phases ? critical(phases) : []).map((phase) => ({ ...levelLine(phase, "x", "").shape, yref: "y2" })),
  ];
  shapes.forEach((shape) => Object.assign(shape.line, { color: MUTED, width: 1, dash: "dot" }));
  const crossover = point.metrics?.loop_crossover,
    annotations = [];
  if (typeof crossover === "number" && crossover > 0) {
    const hertz = crossover / (2 * Math.PI);
    const line = levelLine(hertz, "y", `crossover ${number(hertz, 3)} Hz`);
    shapes.push({ ...line.shape, yref: "paper", line: { color: MUTED, width: 1, dash: "dash" } });
    annotations.push({ ...placed(line, "x", true), font: { size: 11, color: MUTED } });
  }
  const magnitude = {
    ...curve,
    y: decibels(bode.loop_magnitude),
    hovertemplate: "%{x:.4g} Hz<br>|L| %{y:.2f} dB<extra></extra>",
  };
  const phase = {
    ...curve,
    y: phases,
    yaxis: "y2",
    hovertemplate: "%{x:.4g} Hz<br>phase %{y:.1f}°<extra></extra>",
    showlegend: false,
  };
  const two = hasTwoAxes(point),
    other = { line: { color: ORANGE, width: 1.5, dash: "dash" } };
  const beside = two
    ? [
        { ...magnitude, ...other, y: decibels(bode.second_axis_loop_magnitude), name: "second axis" },
        ...(phases && bode.second_axis_loop_phase_deg
          ? [{ ...phase, ...other, y: bode.second_axis_loop_phase_deg }]
          : []),
      ]
    : [];
  return {
    data: [{ ...magnitude, name: "first axis" }, ...(phases ? [phase] : []), ...beside],
    layout: layout({
      ...(two ? { showlegend: true, margin: { l: 56, r: 14, t: 34, b: 44 } } : {}),
      xaxis: decades("Frequency (Hz)", phases ? { anchor: "y2", mirror: "all" } : {}),
      yaxis: axis("|L| (dB)", { domain: [phases ? 0.46 : 0, 1] }),
      ...(phases ? { yaxis2: axis("Phase of L (°)", { domain: [0, 0.42], dtick: turns(phases) }) } : {}),
      shapes,
      annotations,
    }),
  };
}

function sensitivityFigure(point) {
  const { bode } = detailOf(point);
  if (!bode?.sensitivity) return null;
  const shapes = [],
    annotations = [];
  const margin = point.metrics?.modulus_margin;
  const least = (point.constraints ?? []).find((constraint) => constraint.name === "modulus_margin")?.lower;
  const levels = [
    [margin, `1/modulus margin = ${number(1 / margin, 3)}`, { color: MUTED, width: 1, dash: "dot" }],
    [least, `required: at most ${trimmed(1 / least, 3)}`, { color: VERMILION, width: 1.5, dash: "dash" }],
  ];
  levels
    .filter(([value]) => value > 0)
    .forEach(([value, label, style], index) => {
      const line = levelLine(-20 * Math.log10(value), "x", label);
      shapes.push({ ...line.shape, line: style });
      const side = index ? {} : { x: 0, xanchor: "left", yanchor: "top", font: { size: 11, color: MUTED } };
      annotations.push({ ...line.note, bgcolor: "rgba(255,255,255,0)", ...side });
    });
  const curve = (values, name, style) => ({
    x: bode.frequency_hz,
    y: decibels(values),
    name,
    mode: "lines",
    line: { width: 1.6, ...style },
    hovertemplate: `%{x:.4g} Hz<br>${name} %{y:.2f} dB<extra></extra>`,
  });
  // An integrator sends |S| far down at low frequency, where nothing is decided.
  const curves = [bode.sensitivity, bode.complementary_sensitivity, bode.second_axis_sensitivity];
  const peak = Math.max(...curves.flatMap((values) => decibels(values ?? [])), 6);
  return {
    data: [
      curve(bode.sensitivity, "|S|", { color: BLUE }),
      ...(bode.complementary_sensitivity
        ? [curve(bode.complementary_sensitivity, "|T|", { color: ORANGE, dash: "dash" })]
        : []),
      ...(hasTwoAxes(point)
        ? [
            curve(bode.second_axis_sensitivity, "|S| second axis", { color: BLUE, dash: "dot" }),
            curve(bode.second_axis_complementary_sensitivity, "|T| second axis", { color: ORANGE, dash: "dot" }),
          ]
        : []),
    ],
    layout: layout({
      xaxis: decades("Frequency (Hz)"),
      yaxis: axis("Magnitude (dB)", { range: [-60, peak + 8] }),
      shapes,
      annotations,
      showlegend: true,
      margin: { l: 56, r: 14, t: 34, b: 44 },
    }),
  };
}

function polesFigure(point) {
  const poles = (detailOf(point).poles ?? []).filter(([re, im]) => im >= 0 && Math.hypot(re, im) > 0);
  if (!poles.length) return null;
  const group = (chosen, name, marker, word) => ({
    x: chosen.map(([re, im]) => Math.hypot(re, im) / (2 * Math.PI)),
    // An undamped pole has no place on a logarithmic axis; it stands at its lower end.
    y: chosen.map(([re, im]) => Math.max(Math.abs(re) / Math.hypot(re, im), 1e-6)),
    mode: "markers",
    name,
    marker: { size: 8, line: { width: 1.6, color: marker.color }, ...marker },
    hovertemplate: `%{x:.5g} Hz<br>${word} %{y:.3g}<extra></extra>`,
  });
  const growing = poles.filter(([re]) => re >= 0);
  const data = [
    group(
      poles.filter(([re]) => re < 0),
      "decaying",
      { symbol: "x-thin-open", color: BLUE },
      "damping ratio",
    ),
  ];
  if (growing.length)
    data.push(
      group(
        growing,
        "growing (unstable)",
        { symbol: "triangle-up", color: VERMILION, size: 11 },
        "growth ratio",
      ),
    );
  return {
    data,
    layout: layout({
      xaxis: decades("Natural frequency (Hz)"),
      yaxis: decades("Damping ratio"),
      showlegend: growing.length > 0,
      margin: { l: 56, r: 14, t: growing.length ? 34 : 12, b: 44 },
    }),
  };
}
