// Draws the page's figures anew with plotly: values under the pointer, zoom, the cell in space that turns.
// Without a script, without WebGL and on paper the static drawings stay. Nothing is fetched.
(() => {
  "use strict";
  const MARKERS = { round: "circle", square: "square", triangle: "triangle-up", diamond: "diamond", cross: "x" };
  const DASHES = { dot: "dot", dash: "dash" };
  // named one by one: plotly's own choice has a button that sends the chart to a server
  const SCENE_BUTTONS = ["toImage", "zoom3d", "pan3d", "orbitRotation", "resetCameraDefault3d"];
  const CHART_BUTTONS = ["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"];
  const MOST_COUNTED = 10; // steps with a label each
  const MANY_POINTS = 60; // more are smaller
  const WIDE = 1.9; // width over height from which the whole cell is in the picture
  const SLIDER_DECADES = 3; // errors after calibration are up to that much smaller than before
  const touch = window.matchMedia("(pointer: coarse)").matches;
  const drawn = new Map(); // figure -> what is drawn in it

  // -- plotly, which the page carries compressed ---------------------------------------------------------------------

  let library = null;
  const load = () => (library ??= unpack());

  async function unpack() {
    const packed = document.getElementById("plotly").textContent;
    const bytes = Uint8Array.from(atob(packed), (character) => character.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
    return window.Plotly;
  }

  // -- words and colours ---------------------------------------------------------------------------------------------

  // plotly reads markup and placeholders in texts: names that a person wrote must have none
  const plain = (words) =>
    words.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;").replaceAll("%{", "% {");
  const axisWords = (axis) => plain(axis.unit ? `${axis.label} [${axis.unit}]` : axis.label);
  const context = document.createElement("canvas").getContext("2d");

  function colour(name, opacity = 1) {
    context.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim() || "#888888";
    const [red, green, blue] = [1, 3, 5].map((at) => parseInt(context.fillStyle.slice(at, at + 2), 16));
    return `rgba(${red},${green},${blue},${opacity})`;
  }

  const font = () => ({ family: getComputedStyle(document.body).fontFamily, size: 12, color: colour("ink") });
  const hoverlabel = () => ({
    bgcolor: colour("panel"),
    bordercolor: colour("soft"),
    font: { ...font(), color: colour("ink") },
    namelength: -1,
    align: "left",
  });

  // -- charts --------------------------------------------------------------------------------------------------------

  function chartTraces(chart, state) {
    return chart.series.flatMap((series, number) => {
      const visible = !state.hidden.has(number);
      const [lead, trail] = series.band ? bandTraces(series, visible) : [[], []];
      return [...lead, ...trail, seriesTrace(chart, series, visible)];
    });
  }

  function seriesTrace(chart, series, visible) {
    const unit = (axis) => (axis.unit ? ` ${plain(axis.unit)}` : "");
    const parts = [`${plain(chart.x.label)} %{x:.4~r}${unit(chart.x)}`, `%{y:.4~r}${unit(chart.y)}`];
    if (series.band) parts[1] += ` ± %{customdata:.2~r}${unit(chart.y)}`;
    if (series.hints) parts.unshift("%{text}");
    const isPoints = series.kind === "points";
    return {
      type: "scatter",
      name: plain(series.name),
      x: series.x,
      y: series.y,
      text: series.hints && series.hints.map(plain),
      customdata: series.band,
      visible,
      mode: isPoints ? "markers" : series.marked ? "lines+markers" : "lines",
      hovertemplate: `${parts.join("<br>")}<extra>${plain(series.name)}</extra>`,
      line: {
        color: colour(series.colour),
        width: DASHES[series.swatch] ? 1 : 1.8,
        dash: DASHES[series.swatch] || "solid",
        shape: series.kind === "steps" ? "hv" : "linear",
      },
      marker: {
        color: colour(series.colour),
        size: series.x.length > MANY_POINTS ? 5 : series.swatch === "round" ? 7 : 10,
        symbol: (MARKERS[series.swatch] || "circle") + (series.hollow ? "-open" : ""),
      },
    };
  }

  function bandTraces(series, visible) {
    const edge = (sign) => ({
      type: "scatter",
      mode: "lines",
      x: series.x,
      y: series.y.map((value, row) => (value === null ? null : value + sign * series.band[row])),
      line: { width: 0 },
      hoverinfo: "skip",
      visible,
    });
    return [[edge(-1)], [{ ...edge(1), fill: "tonexty", fillcolor: colour(series.colour, 0.22) }]];
  }

  function axisLayout(axis) {
    return {
      title: { text: axisWords(axis), font: { size: 12 }, standoff: 8 },
      type: axis.log ? "log" : "linear",
      exponentformat: "none",
      color: colour("ink"),
      gridcolor: colour("grid"),
      linecolor: colour("soft"),
      showline: true,
      zeroline: false,
      fixedrange: touch,
    };
  }

  const lowest = (chart) =>
    Math.min(...chart.series.flatMap(({ y, band }) => (band ? y.map((value, row) => value - band[row]) : y)));

  // Within few decades plotly labels every multiple, which overlap: 1, 2 and 5 are enough. Without a format it labels
  // them by their first digit alone, so that an axis reads 2, 1, 5, 2.
  function setLogTicks(axis, chart, name) {
    if (axis.type !== "log") return;
    axis.tickformat = "~g";
    const limits = chart.limits.filter((limit) => limit.axis === name).map(({ value }) => value);
    const values = [...limits, ...chart.series.flatMap((series) => series[name])].filter((value) => value > 0);
    const decades = Math.log10(Math.max(...values) / Math.min(...values));
    if (decades < 3 && (decades > 0.8 || decades === 0)) axis.dtick = "D2";
  }

  function countsFew(chart) {
    const values = chart.series.flatMap(({ x }) => x).filter((value) => value !== null);
    return values.every(Number.isInteger) && Math.max(...values) - Math.min(...values) <= MOST_COUNTED;
  }

  function chartLayout(chart) {
    const [xaxis, yaxis] = [axisLayout(chart.x), axisLayout(chart.y)];
    if (countsFew(chart)) xaxis.dtick = 1;
    setLogTicks(xaxis, chart, "x");
    setLogTicks(yaxis, chart, "y");
    if (chart.equal) yaxis.scaleanchor = "x";
    if (chart.range) yaxis.range = chart.range;
    else if (!chart.equal && lowest(chart) >= 0) yaxis.rangemode = "nonnegative";
    yaxis.automargin = true;
    const line = { color: colour("ink"), width: 1.2, dash: "dash" };
    const shapes = chart.limits.map(({ axis, value }) =>
      axis === "x"
        ? { type: "line", x0: value, x1: value, yref: "paper", y0: 0, y1: 1, line }
        : { type: "line", y0: value, y1: value, xref: "paper", x0: 0, x1: 1, line },
    );
    return { xaxis, yaxis, shapes, margin: { l: 52, r: 12, t: 22, b: 42 }, dragmode: touch ? false : "zoom" };
  }

  // -- the cell in space ---------------------------------------------------------------------------------------------

  const flat = (lists) => lists.flat();
  const columns = (rows) => [0, 1, 2].map((axis) => rows.map((row) => row && row[axis]));
  const placed = ([x, y, z]) => ({ x, y, z });

  function sceneTraces(scene, state) {
    return scene.layers.flatMap((layer, number) =>
      LAYERS[layer.kind](layer, state).map((trace) => ({
        name: plain(layer.name),
        hoverinfo: "skip",
        ...trace,
        visible: !state.hidden.has(number),
      })),
    );
  }

  const LAYERS = {
    arm: (layer) => [
      { ...capsules(layer), color: colour(layer.colour), opacity: 0.45, flatshading: false },
      {
        ...placed(layer.chain),
        type: "scatter3d",
        mode: "lines+markers",
        line: { color: colour(layer.colour), width: 7 },
        marker: { color: colour("ink"), size: 3 },
        hoverinfo: "name",
      },
    ],
    stops: (layer) => [
      {
        ...placed(layer.at),
        type: "scatter3d",
        mode: "markers",
        marker: { color: colour(layer.colour), size: 2.2, opacity: 0.8 },
        text: layer.hints.map(plain),
        hoverinfo: "text",
      },
    ],
    errors: (layer, state) => {
      const tips = layer.at.map((values, axis) =>
        values.map((value, row) => value + layer.step_mm[axis][row] * 1e-3 * state.enlarged),
      );
      const gaps = layer.at.map((values, axis) => flat(values.map((value, row) => [value, tips[axis][row], null])));
      const of = { type: "scatter3d", hoverinfo: "skip" };
      return [
        { ...of, ...placed(gaps), mode: "lines", line: { color: colour(layer.colour), width: 3 } },
        {
          ...of,
          ...placed(tips),
          mode: "markers",
          marker: { color: colour(layer.colour), size: 2.6 },
          text: layer.hints.map(plain),
          hoverinfo: "text",
        },
      ];
    },
    obstacles: (layer) =>
      layer.bodies.map((body) => ({
        ...placed(body.at),
        type: "mesh3d",
        alphahull: 0,
        color: colour("soft"),
        opacity: 0.3,
        text: plain(body.name),
        hoverinfo: "text",
      })),
    tracker: (layer) => [
      {
        ...placed(layer.at),
        type: "scatter3d",
        mode: "markers",
        marker: { color: colour("ink"), size: 7, symbol: "diamond" },
        text: "tracker",
        hoverinfo: "text",
      },
      {
        ...placed(columns(flat(layer.sights.map((end) => [[0, 0, 0], end, null])))),
        type: "scatter3d",
        mode: "lines",
        line: { color: colour("soft"), width: 2, dash: "dot" },
      },
    ],
  };

  // One mesh of all capsules: rings of points around each axis, from pole to pole.
  function capsules({ start, end, radius }) {
    const [AROUND, RINGS] = [12, 8];
    const mesh = { type: "mesh3d", x: [], y: [], z: [], i: [], j: [], k: [] };
    start.forEach((from, body) => {
      const along = unit(end[body].map((value, axis) => value - from[axis]));
      const [u, v] = across(along);
      const first = mesh.x.length;
      for (let ring = 0; ring < RINGS; ring += 1) {
        const angle = (Math.PI * ring) / (RINGS - 1) - Math.PI / 2;
        const centre = ring < RINGS / 2 ? from : end[body];
        for (let step = 0; step < AROUND; step += 1) {
          const turn = (2 * Math.PI * step) / AROUND;
          const [a, b, c] = [Math.cos(angle) * Math.cos(turn), Math.cos(angle) * Math.sin(turn), Math.sin(angle)];
          ["x", "y", "z"].forEach((name, axis) =>
            mesh[name].push(centre[axis] + radius[body] * (a * u[axis] + b * v[axis] + c * along[axis])),
          );
          if (ring === 0) continue;
          const [here, next] = [step, (step + 1) % AROUND].map((at) => first + ring * AROUND + at);
          mesh.i.push(here, next);
          mesh.j.push(next, next - AROUND);
          mesh.k.push(here - AROUND, here - AROUND);
        }
      }
    });
    return mesh;
  }

  function unit(vector) {
    const length = Math.hypot(...vector);
    return length < 1e-9 ? [0, 0, 1] : vector.map((value) => value / length);
  }

  function across([x, y, z]) {
    const u = unit(Math.abs(z) < 0.9 ? [-y, x, 0] : [0, -z, y]);
    return [u, [y * u[2] - z * u[1], z * u[0] - x * u[2], x * u[1] - y * u[0]]];
  }

  function sceneLayout(scene, aspect) {
    const axis = (name) => ({
      title: { text: `${name} [m]` },
      color: colour("soft"),
      gridcolor: colour("grid"),
      zerolinecolor: colour("grid"),
      showbackground: false,
      showspikes: false,
    });
    const space = { xaxis: axis("x"), yaxis: axis("y"), zaxis: axis("z"), aspectmode: "data", dragmode: "turntable" };
    const away = Math.max(1, WIDE / aspect) ** 0.6; // a narrow picture shows the cell's width from farther away
    const [x, y, z] = scene.eye.map((value) => value * away);
    const camera = { eye: { x, y, z }, center: { x: 0, y: 0, z: -0.15 } };
    return { scene: { ...space, camera }, margin: { l: 0, r: 0, t: 0, b: 0 } };
  }

  function canDrawSpace() {
    const canvas = document.createElement("canvas");
    return Boolean(window.WebGLRenderingContext && (canvas.getContext("webgl2") || canvas.getContext("webgl")));
  }

  // -- figures -------------------------------------------------------------------------------------------------------

  async function draw(figure) {
    if (drawn.has(figure)) return;
    const source = figure.querySelector('script[type="application/json"]');
    const data = JSON.parse(source.textContent);
    const still = figure.querySelector(".drawing");
    const state = { figure, data, hidden: new Set(), enlarged: data.enlarged, live: document.createElement("div") };
    drawn.set(figure, state);
    const isScene = data.kind === "scene";
    if (isScene && !canDrawSpace()) {
      say(figure, "This browser has no WebGL: the picture does not turn.");
      return;
    }
    try {
      const Plotly = await load();
      state.live.className = "live";
      state.live.style.height = `${Math.max(still.clientHeight, isScene ? 340 : 230)}px`;
      still.after(state.live);
      figure.classList.add("is-live");
      await paint(Plotly, state);
      addSwitches(Plotly, state);
      if (isScene) addSlider(Plotly, state);
    } catch (error) {
      state.live.remove();
      figure.classList.remove("is-live");
      console.warn("a figure stays still", error);
    }
  }

  function paint(Plotly, state) {
    const isScene = state.data.kind === "scene";
    const traces = isScene ? sceneTraces(state.data, state) : chartTraces(state.data, state);
    const layout = {
      ...(isScene ? sceneLayout(state.data, state.live.clientWidth / state.live.clientHeight) : chartLayout(state.data)),
      font: font(),
      hoverlabel: hoverlabel(),
      hovermode: "closest",
      showlegend: false,
      paper_bgcolor: "rgba(0,0,0,0)",
      plot_bgcolor: "rgba(0,0,0,0)",
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("soft"), activecolor: colour("ink") },
      uirevision: "as the reader left it",
    };
    const config = {
      responsive: true,
      displaylogo: false,
      scrollZoom: false, // the wheel scrolls the page
      displayModeBar: isScene ? true : "hover",
      modeBarButtons: [isScene ? SCENE_BUTTONS : CHART_BUTTONS],
      plotlyServerURL: "",
    };
    return Plotly.react(state.live, traces, layout, config);
  }

  // Entries of the legend turn what they name off and on.
  function addSwitches(Plotly, state) {
    const entries = [...state.figure.querySelectorAll(".legend li[data-series]")];
    if (entries.length < 2) return;
    for (const entry of entries) {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...entry.childNodes);
      button.setAttribute("aria-pressed", "true");
      button.addEventListener("click", () => {
        const hide = button.getAttribute("aria-pressed") === "true";
        button.setAttribute("aria-pressed", String(!hide));
        for (const number of entry.dataset.series.split(" ").map(Number)) {
          if (hide) state.hidden.add(number);
          else state.hidden.delete(number);
        }
        paint(Plotly, state);
      });
      entry.append(button);
    }
  }

  function addSlider(Plotly, state) {
    if (!state.data.layers.some((layer) => layer.kind === "errors")) return;
    const fixed = state.figure.querySelector(".legend li:not([data-series])");
    const [label, input, shown] = ["label", "input", "output"].map((tag) => document.createElement(tag));
    const start = Math.log10(state.data.enlarged);
    Object.assign(input, { type: "range", min: start - 1, max: start + SLIDER_DECADES, step: 0.05, value: start });
    label.className = "slider";
    label.append("errors drawn ", input, " ", shown, " times longer than they are");
    const show = () => {
      state.enlarged = Number((10 ** Number(input.value)).toPrecision(2));
      shown.textContent = state.enlarged;
    };
    show();
    input.addEventListener("input", () => {
      show();
      paint(Plotly, state);
    });
    const printed = document.createElement("span");
    printed.className = "printed";
    printed.append(...fixed.childNodes);
    fixed.replaceChildren(label, printed);
  }

  function say(figure, words) {
    const note = document.createElement("p");
    note.className = "note";
    note.textContent = words;
    figure.append(note);
  }

  async function recolour() {
    const Plotly = await load();
    for (const [figure, state] of drawn) if (figure.classList.contains("is-live")) paint(Plotly, state);
  }

  function start() {
    const figures = [...document.querySelectorAll("figure")].filter((figure) =>
      figure.querySelector('script[type="application/json"]'),
    );
    const packed = document.getElementById("plotly");
    if (!figures.length || !packed || !packed.textContent || !window.DecompressionStream) return;
    const inView = new IntersectionObserver((entries) => {
      for (const entry of entries) if (entry.isIntersecting) draw(entry.target);
    });
    for (const figure of figures) {
      inView.observe(figure);
      figure.addEventListener("pointerenter", () => draw(figure), { once: true });
    }
    const recolourDrawn = () => drawn.size && recolour();
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", recolourDrawn);
    const attributes = { attributes: true, attributeFilter: ["class", "style", "data-theme"] };
    new MutationObserver(recolourDrawn).observe(document.documentElement, attributes);
  }

  start();
})();
