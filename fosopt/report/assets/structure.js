// The structure of one point: bars with width and color by area, and what is attached where.

const LEVELS = 24;
// Viridis without its palest fifth, which a white page swallows; the largest area is the darkest.
const AREA_COLORS = ["#5ec962", "#28ae80", "#21918c", "#2c728e", "#3b528b", "#472d7b", "#440154"];
const WIDEST = 9;
const THINNEST = 0.6;

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
      // Ink is to scale with mass: a line's width with the area of the bar it stands for.
      const color = areaColor(largest > least ? level / LEVELS : 1);
      return trace(segments(truss, bars), {
        color,
        width: Math.max(THINNEST, (WIDEST * area) / largest),
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
  const { truss, structure, places = [] } = detailOf(point);
  if (structure?.kind === "beam") return beamFigure(structure, places);
  if (structure?.kind === "chain") return chainFigure(structure, places);
  if (!truss) return null;
  return truss.nodes[0].length === 3 ? spatialFigure(truss, places) : planarFigure(truss, places);
}

function structureCaption(point) {
  const { truss, structure } = detailOf(point);
  if (structure) return plainCaption(structure);
  if (!truss) return "";
  if (!truss.bars.length) return "Structure of rigid battens without bars; gray: battens.";
  const { unit, factor } = areaUnit();
  const range = span(scaled(truss.areas, factor));
  const areas =
    range.size > 1e-9 * range.most
      ? `${number(range.least)} to ${withUnit(number(range.most), unit)}`
      : withUnit(number(range.most), unit);
  return [
    `Truss of ${truss.bars.length} bars, areas ${areas}.`,
    `Line width is to scale with the area, ${WIDEST} px for the largest and ${THINNEST} px at least;`,
    "color shows the area. Gray: battens.",
    ...(isSlender(truss) ? ["Below: area at the middle of each bar."] : []),
    ...(isSpatial(point) ? [`Parallel projection, ${VIEWS[lookedFrom].name}.`] : []),
  ].join(" ");
}

function isSpatial(point) {
  return detailOf(point).truss?.nodes[0].length === 3;
}

const line2d = ([x, y], line) => ({ x, y, mode: "lines", line, hoverinfo: "skip", showlegend: false });

function drawnBars(truss) {
  return [
    line2d(segments(truss, truss.battens ?? []), { color: "#8b929b", width: 1.2 }),
    ...(truss.bars.length ? barTraces(truss, line2d) : []),
  ];
}

function planarFigure(truss, places) {
  const [x, y] = middles(truss);
  const data = drawnBars(truss);
  if (truss.bars.length) data.push(colorMarkers(truss, { x, y, showlegend: false }));
  data.push(...placeTraces(places, (place) => place.xyz));
  const slender = isSlender(truss);
  if (slender) data.push(...profileTraces(truss));
  const length = span(truss.nodes.map((node) => node[0]));
  const equal = { scaleanchor: "x", scaleratio: 1, showgrid: false };
  return {
    data,
    layout: layout({
      xaxis: axis("x (m)", {
        showgrid: false,
        range: [length.least - 0.03 * length.size, length.most + 0.03 * length.size],
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

const VIEWS = [
  { name: "from aside and above", right: null, up: null },
  { name: "onto the x–y plane", right: 0, up: 1 },
  { name: "onto the x–z plane", right: 0, up: 2 },
  { name: "onto the y–z plane", right: 1, up: 2 },
];
let lookedFrom = 0;

// Directions of the picture in space. From aside the longest side lies along the picture, unless it stands.
function picture(truss) {
  const { right, up } = VIEWS[lookedFrom];
  const unit = (k) => [0, 1, 2].map((index) => Number(index === k));
  if (right !== null) return [unit(right), unit(up)];
  const sides = [0, 1, 2].map((k) => span(truss.nodes.map((node) => node[k])).size);
  const eye = [
    [0.35, -0.86, 0.37],
    [0.86, -0.35, 0.37],
    [0.55, -0.8, 0.24],
  ][sides.indexOf(Math.max(...sides))];
  const across = Math.hypot(eye[0], eye[1]),
    size = Math.hypot(...eye);
  const level = [-eye[1] / across, eye[0] / across, 0];
  return [
    level,
    [(-eye[0] * eye[2]) / across / size, (-eye[1] * eye[2]) / across / size, across / size],
  ];
}

function ontoPicture(directions) {
  return (node) => directions.map((direction) => direction.reduce((sum, value, k) => sum + value * node[k], 0));
}

// The three directions of space at the lower left, where the axes cannot be read off the frame.
function triad([right, up], low, size) {
  return ["x", "y", "z"].flatMap((name, k) => {
    const end = [low[0] + size * right[k], low[1] + size * up[k]];
    return [
      { x: end[0], y: end[1], ax: low[0], ay: low[1], axref: "x", ayref: "y", text: "", arrowcolor: MUTED, arrowhead: 2 },
      {
        x: low[0] + 1.35 * size * right[k],
        y: low[1] + 1.35 * size * up[k],
        text: name,
        showarrow: false,
        font: { size: 11.5, color: MUTED },
      },
    ];
  });
}

function spatialFigure(truss, places) {
  const directions = picture(truss);
  const onto = ontoPicture(directions);
  const flat = { ...truss, nodes: truss.nodes.map(onto) };
  const [x, y] = middles(flat);
  const [wide, high] = [0, 1].map((k) => span(flat.nodes.map((node) => node[k])));
  const { right, up } = VIEWS[lookedFrom];
  const size = 0.12 * Math.max(wide.size, high.size);
  const corner = [wide.least - 1.6 * size, high.least - 1.2 * size];
  const frame = right === null ? frameless() : null;
  return {
    data: [
      ...drawnBars(flat),
      ...(truss.bars.length ? [{ ...colorMarkers(truss, { x, y, showlegend: false }), hovertext: barTexts(truss) }] : []),
      ...placeTraces(places, (place) => onto(place.xyz)),
    ],
    layout: layout({
      xaxis: frame ?? axis(`${"xyz"[right]} (m)`, { showgrid: false, constrain: "domain" }),
      yaxis: {
        ...(frame ?? axis(`${"xyz"[up]} (m)`, { showgrid: false, constrain: "domain" })),
        scaleanchor: "x",
        scaleratio: 1,
      },
      annotations: frame ? triad(directions, corner, size) : [],
      margin: { l: 56, r: 14, t: 18, b: 44 },
    }),
  };
}

// A spatial truss is looked at from four sides, at rest and deformed from the same one.
function viewButtons(id) {
  const buttons = VIEWS.map(({ name }, index) => {
    const state = { "data-view": index, "aria-pressed": String(index === lookedFrom) };
    const button = element("button", { type: "button", class: "view", ...state }, name);
    button.addEventListener("click", () => lookFrom(index));
    return button;
  });
  const group = { class: "views", role: "group", "aria-label": "View of the truss", hidden: "" };
  return element("div", { id: `${id}-views`, ...group }, ...buttons);
}

function lookFrom(index) {
  lookedFrom = index;
  for (const each of document.querySelectorAll(".view"))
    each.setAttribute("aria-pressed", String(Number(each.dataset.view) === index));
  for (const panel of PANELS.filter(([id]) => ["structure", "shape"].includes(id))) fillPanel(panel, selected);
}
