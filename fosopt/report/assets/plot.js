// What all figures share: colors, axes, layout and limit lines.

const INK = "#1b1f24",
  MUTED = "#5b6470",
  GRID = "#e6e9ed",
  PAPER = "#ffffff";
const BLUE = "#0072b2",
  VERMILION = "#d55e00",
  GREEN = "#009e73",
  ORANGE = "#e69f00",
  PURPLE = "#b0578d",
  SKY = "#56b4e9";
const SOURCES = [BLUE, ORANGE, GREEN, PURPLE, SKY, "#7f6a00"];
const DASHES = ["solid", "dash", "dot", "dashdot", "longdash", "longdashdot"];
const FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "Liberation Sans", sans-serif';

// plotly reads a few tags in its texts; what a user wrote must stay text.
function plain(text) {
  return String(text).replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
}

function axis(title, more = {}) {
  return {
    title: { text: plain(title), standoff: 8 },
    showline: true,
    mirror: true,
    linecolor: MUTED,
    linewidth: 1,
    ticks: "inside",
    tickcolor: MUTED,
    ticklen: 4,
    gridcolor: GRID,
    zeroline: false,
    automargin: true,
    exponentformat: "e",
    ...more,
  };
}

function decades(title, more = {}) {
  return axis(title, {
    type: "log",
    dtick: 1,
    tickformat: "~g",
    minor: { ticks: "inside", ticklen: 2, tickcolor: MUTED },
    ...more,
  });
}

function layout(more) {
  return {
    font: { family: FONT, size: 12, color: INK },
    paper_bgcolor: PAPER,
    plot_bgcolor: PAPER,
    autosize: true,
    margin: { l: 56, r: 14, t: 12, b: 44 },
    hovermode: "closest",
    showlegend: false,
    hoverlabel: {
      bgcolor: PAPER,
      bordercolor: MUTED,
      font: { family: FONT, size: 12, color: INK },
      align: "left",
    },
    legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", font: { size: 11.5 } },
    dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
    ...more,
  };
}

function levelLine(value, across, label, more = {}) {
  const line = { type: "line", line: { color: VERMILION, width: 1.5, dash: "dash" }, ...more };
  const note = {
    text: plain(label),
    showarrow: false,
    font: { size: 11, color: "#a64500" },
    bgcolor: "rgba(255,255,255,.8)",
  };
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
