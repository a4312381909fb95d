// The truss of one point: line width and color by area.

const LEVELS = 24;
// Viridis without its palest fifth, which a white page swallows; the largest area is the darkest.
const AREA_COLORS = ["#5ec962", "#28ae80", "#21918c", "#2c728e", "#3b528b", "#472d7b", "#440154"];
const WIDEST = 7;

function areaColor(fraction) {
  const place = Math.min(Math.max(fraction, 0), 1) * (AREA_COLORS.length - 1);
  const low = Math.min(Math.floor(place), AREA_COLORS.length - 2);
  const channel = (text, index) => parseInt(text.slice(1 + 2 * index, 3 + 2 * index), 16);
  const mixed = [0, 1, 2].map((index) =>
    Math.round(
      channel(AREA_COLORS[low], index) * (1 + low - place) +
        channel(AREA_COLORS[low + 1], index) * (place - low),
    ),
  );
  return `rgb(${mixed.join(",")})`;
}

function areaUnit() {
  const known = run.quantities?.area;
  return known ? { unit: unitText(known.unit), factor: known.factor ?? 1 } : { unit: "mm²", factor: 1e6 };
}

function segments(truss, pairs) {
  const made = [[], [], []];
  for (const pair of pairs) {
    for (const node of pair) made.forEach((list, k) => list.push(truss.nodes[node][k] ?? 0));
    made.forEach((list) => list.push(null));
  }
  return made;
}

// One trace for each of a few widths instead of one for each bar keeps trusses of thousands of bars quick.
function barTraces(truss, trace) {
  const largest = Math.max(...truss.areas),
    least = Math.min(...truss.areas);
  const groups = new Map();
  truss.bars.forEach((bar, index) => {
    const fraction = largest > least ? (truss.areas[index] - least) / (largest - least) : 1;
    const level = Math.round(fraction * LEVELS);
    groups.set(level, [...(groups.get(level) ?? []), bar]);
  });
  return [...groups]
    .sort(([a], [b]) => a - b)
    .map(([level, bars]) => {
      const area = least + (largest - least) * (level / LEVELS);
      const color = areaColor(largest > least ? level / LEVELS : 1);
      return trace(segments(truss, bars), {
        color,
        width: Math.max(0.8, WIDEST * Math.sqrt(area / largest)),
      });
    });
}

function barTexts(truss) {
  const { unit, factor } = areaUnit();
  return truss.bars.map(([i, j], index) => {
    const [a, b] = [truss.nodes[i], truss.nodes[j]];
    const length = Math.hypot(...a.map((value, k) => value - b[k]));
    const name = [truss.kinds?.[index], truss.names?.[index]].filter(Boolean).map(plain).join(" ");
    const area = withUnit(number(truss.areas[index] * factor), unit);
    return `${name}<br>area ${area}<br>length ${number(length)} m`;
  });
}

function middles(truss) {
  const middle = ([i, j], k) => ((truss.nodes[i][k] ?? 0) + (truss.nodes[j][k] ?? 0)) / 2;
  return [0, 1, 2].map((k) => truss.bars.map((bar) => middle(bar, k)));
}

function colorMarkers(truss, more) {
  const { unit, factor } = areaUnit();
  const areas = scaled(truss.areas, factor);
  const scale = AREA_COLORS.map((color, index) => [index / (AREA_COLORS.length - 1), color]);
  return {
    mode: "markers",
    hoverinfo: "text",
    hovertext: barTexts(truss),
    marker: {
      size: 9,
      opacity: 0,
      color: areas,
      colorscale: scale,
      cmin: Math.min(...areas),
      cmax: Math.max(...areas),
      showscale: true,
      colorbar: {
        title: { text: `Area (${unit})`, side: "right" },
        thickness: 12,
        len: 1,
        outlinewidth: 0,
        ticks: "inside",
      },
    },
    ...more,
  };
}

function span(values) {
  const [least, most] = [Math.min(...values), Math.max(...values)];
  return { least, most, size: most - least };
}

function isSlender(truss) {
  const [x, y] = [0, 1].map((k) => span(truss.nodes.map((node) => node[k])));
  return truss.nodes[0].length === 2 && y.size < 0.25 * x.size;
}

// Bars of one kind above and below the center line are different chords.
function chords(truss) {
  const [x, y] = middles(truss);
  const extent = span(y),
    center = (extent.least + extent.most) / 2;
  const groups = new Map();
  truss.bars.forEach((_, index) => {
    const offset = (y[index] - center) / (extent.size || 1);
    const side = Math.abs(offset) < 0.05 ? "" : offset > 0 ? ", upper" : ", lower";
    const name = `${truss.kinds?.[index] ?? "bar"}${side}`;
    groups.set(name, [...(groups.get(name) ?? []), index]);
  });
  return [...groups].map(([name, members]) => ({ name, members: members.sort((a, b) => x[a] - x[b]) }));
}

function profileTraces(truss) {
  const { unit, factor } = areaUnit();
  const [x] = middles(truss);
  const symbols = ["circle", "square-open", "diamond", "triangle-up-open", "star"];
  return chords(truss).map(({ name, members }, index) => ({
    x: members.map((bar) => x[bar]),
    y: members.map((bar) => truss.areas[bar] * factor),
    yaxis: "y2",
    mode: "lines+markers",
    name: plain(name),
    line: { color: SOURCES[index % SOURCES.length], width: 1.2, dash: DASHES[index % 4] },
    marker: { size: 6, symbol: symbols[index % symbols.length] },
    hoverinfo: "text",
    hovertext: members.map(
      (bar) => `${plain(truss.names?.[bar] ?? name)}<br>${withUnit(number(truss.areas[bar] * factor), unit)}`,
    ),
  }));
}

function structureFigure(point) {
  const truss = point.detail?.truss;
  if (!truss?.bars?.length) return null;
  return truss.nodes[0].length === 3 ? spatialFigure(truss) : planarFigure(truss);
}

function planarFigure(truss) {
  const trace = ([x, y], line) => ({ x, y, mode: "lines", line, hoverinfo: "skip", showlegend: false });
  const [x, y] = middles(truss);
  const data = [
    trace(segments(truss, truss.battens ?? []), { color: "#8b929b", width: 1.2 }),
    ...barTraces(truss, trace),
    colorMarkers(truss, { x, y, showlegend: false }),
  ];
  const slender = isSlender(truss);
  if (slender) data.push(...profileTraces(truss));
  const length = span(truss.nodes.map((node) => node[0]));
  const equal = { scaleanchor: "x", scaleratio: 1, showgrid: false };
  return {
    data,
    layout: layout({
      xaxis: axis("x (m)", {
        showgrid: false,
        range: [length.least - 0.015 * length.size, length.most + 0.015 * length.size],
        anchor: slender ? "y2" : "y",
        mirror: slender ? "all" : true,
        constrain: slender ? "range" : "domain",
      }),
      yaxis: axis(
        "y (m)",
        slender ? { ...equal, domain: [0.68, 1], nticks: 4 } : { ...equal, constrain: "domain" },
      ),
      ...(slender
        ? { yaxis2: axis(`Area (${areaUnit().unit})`, { domain: [0, 0.57], rangemode: "tozero" }) }
        : {}),
      showlegend: slender,
      legend: {
        orientation: "h",
        x: 0,
        y: 0.58,
        yanchor: "bottom",
        font: { size: 11.5 },
        bgcolor: "rgba(255,255,255,0)",
      },
    }),
  };
}

// Looks across the longest side, so that a mast lies along the figure or stands in it.
function view(truss) {
  const sides = [0, 1, 2].map((k) => span(truss.nodes.map((node) => node[k])).size);
  const longest = sides.indexOf(Math.max(...sides));
  // The figure is wide and low: what is slender and lies may fill its width.
  const second = [...sides].sort((a, b) => b - a)[1] / sides[longest];
  const size = longest === 2 ? 1.5 : 3.4 - 2 * second;
  const ratio = sides.map((side) => size * Math.max(side / sides[longest], 1e-3));
  const [x, y, z] = [
    [0.45, -1.5, 0.7],
    [1.5, 0.45, 0.7],
    [1.2, -1.2, 0.35],
  ][longest];
  return {
    aspectmode: "manual",
    aspectratio: { x: ratio[0], y: ratio[1], z: ratio[2] },
    camera: { eye: { x, y, z }, projection: { type: "orthographic" } },
    // Along a short side numbers would stand on top of each other.
    axes: sides.map((side) => ({ showticklabels: side > 0.25 * sides[longest] })),
  };
}

function spatialFigure(truss) {
  const trace = ([x, y, z], line) => ({
    type: "scatter3d",
    x,
    y,
    z,
    mode: "lines",
    line,
    hoverinfo: "skip",
    showlegend: false,
  });
  const [x, y, z] = middles(truss);
  const { axes, ...scene } = view(truss);
  const [xaxis, yaxis, zaxis] = axes.map((more, k) => ({
    title: { text: `${"xyz"[k]} (m)` },
    backgroundcolor: PAPER,
    gridcolor: GRID,
    zerolinecolor: GRID,
    color: MUTED,
    ...more,
  }));
  return {
    data: [
      trace(segments(truss, truss.battens ?? []), { color: "#8b929b", width: 1.5 }),
      ...barTraces(truss, trace),
      colorMarkers(truss, { type: "scatter3d", x, y, z, showlegend: false }),
    ],
    layout: layout({
      scene: { ...scene, xaxis, yaxis, zaxis, dragmode: "orbit" },
      margin: { l: 0, r: 0, t: 0, b: 0 },
    }),
  };
}
