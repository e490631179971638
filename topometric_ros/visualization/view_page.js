"use strict";
// State of the page lives in the address after '#': #room=3&storey=1&colour=agent
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const at = id => document.getElementById(id);
  const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer;
  const xyz = new Float32Array(bytes(data.points.xyz));
  const room = new Int32Array(bytes(data.points.room));
  const storey = new Uint8Array(bytes(data.points.storey));
  const observers = new Uint8Array(bytes(data.points.observers));
  const upper = new Uint8Array(bytes(data.points.upper));
  const rooms = new Map(data.rooms.map(r => [r.id, r]));
  const plain = "#b8b8b8", faint = "#c9ced4", seen = "#c25b00";
  const state = {stage: "rooms", view: null, pair: 0, colour: "room", storey: 0, room: null};
  const titles = {rooms: "rooms", navigable: "navigable volume", distance: "distance field and viewpoints",
    isovist: "isovist", similarity: "similarity matrix and graph", matches: "matches side by side",
    trajectories: "trajectories"};
  const stageOf = () => data.stages[state.stage] || {};
  const colours = {
    room: i => (rooms.get(room[i]) || {colour: plain}).colour,
    agent: i => data.classes[observers[i]].colour,
    storey: i => data.storeys[storey[i]].colour,
  };

  // One trace of points for each storey and half, so that slider and check box only hide and show.
  const parts = [];
  data.storeys.forEach((_, s) => [0, 1].forEach(u => {
    const rows = [];
    for (let i = 0; i < storey.length; i++) if (storey[i] === s && upper[i] === u) rows.push(i);
    if (rows.length) parts.push({kind: "points", storey: s, upper: u, rows});
  }));
  const pointTrace = part => ({
    type: "scatter3d", mode: "markers", hoverinfo: "text", showlegend: false,
    x: Float32Array.from(part.rows, i => xyz[3 * i]),
    y: Float32Array.from(part.rows, i => xyz[3 * i + 1]),
    z: Float32Array.from(part.rows, i => xyz[3 * i + 2]),
    text: part.rows.map(i => (rooms.get(room[i]) || {name: "no room"}).name),
    customdata: part.rows.map(i => room[i]),
    marker: {size: pointSize(), color: part.rows.map(pointColour)},
  });
  data.storeys.forEach((_, s) => parts.push({kind: "edges", storey: s}, {kind: "nodes", storey: s}));
  const edgeTrace = part => {
    const line = {x: [], y: [], z: []};
    for (const edge of data.edges.filter(e => e.storeys.includes(part.storey))) {
      for (const p of edge.path) { line.x.push(p[0]); line.y.push(p[1]); line.z.push(p[2]); }
      line.x.push(null); line.y.push(null); line.z.push(null);
    }
    return {type: "scatter3d", mode: "lines", hoverinfo: "skip", showlegend: false,
      line: {color: "#1d2228", width: 4}, ...line};
  };
  const nodeTrace = part => {
    const here = data.rooms.filter(r => r.storey === part.storey);
    return {type: "scatter3d", mode: "markers+text", hoverinfo: "text", showlegend: false,
      x: here.map(r => r.node[0]), y: here.map(r => r.node[1]), z: here.map(r => r.node[2]),
      text: here.map(r => String(r.id)), hovertext: here.map(r => r.name),
      customdata: here.map(r => r.id), textposition: "top center", textfont: {size: 13},
      marker: {size: 8, color: here.map(r => r.colour), line: {color: "#1d2228", width: 2}}};
  };
  const makers = {points: pointTrace, edges: edgeTrace, nodes: nodeTrace};
  const wanted = new URLSearchParams(location.hash.slice(1));
  state.view = wanted.has("view") ? parseInt(wanted.get("view")) : null;
  parts.push(...stageParts(data, bytes, state.view));
  const onStorey = part => state.storey === 0 || part.storey < 0 || part.storey === state.storey - 1;
  const shown = part => {
    if (part.stage) return part.stage === state.stage && onStorey(part) && (part.kind !== "pair" || part.pair === state.pair);
    if (state.stage === "matches" && !stageOf().missing || !onStorey(part)) return false;
    return part.kind === "points" ? !part.upper || at("upper").checked : state.stage === "rooms" && at("graph").checked;
  };
  const pointColour = i => {
    if (state.stage === "rooms") return colours[state.colour](i);
    return state.stage === "isovist" && !stageOf().missing && stageOf().sees(i) ? seen : faint;
  };

  // What a stage adds should show through the walls before it.
  const pointSize = () => state.stage === "rooms" || state.stage === "isovist" ? 2 : 1.2;

  const legend = () => {
    const stage = stageOf();
    const entries = state.stage === "rooms" ? {room: [], agent: data.classes, storey: data.storeys}[state.colour]
      : stage.missing ? [] : stage.ways || (state.stage === "isovist" ? [{name: "viewpoint and range", colour: "#d1003f"},
        {name: `seen: ${stage.seen[stage.chosen].toLocaleString("en")} voxels`, colour: seen}, {name: "not seen", colour: faint}] : []);
    at("legend").replaceChildren(...entries.map(entry => {
      const line = document.createElement("span"), swatch = document.createElement("span");
      swatch.className = "swatch"; swatch.style.background = entry.colour;
      line.append(swatch, entry.name, document.createElement("br"));
      return line;
    }));
  };
  const select = id => {
    const found = rooms.get(id);
    if (!found) return;
    state.room = id;
    const title = document.createElement("b"), list = document.createElement("dl");
    title.textContent = found.name;
    for (const [name, value] of found.attributes) {
      const term = document.createElement("dt"), text = document.createElement("dd");
      term.textContent = name; text.textContent = value; list.append(term, text);
    }
    at("room").replaceChildren(title, list);
    for (const button of at("rooms").children)
      button.setAttribute("aria-pressed", String(Number(button.dataset.room) === id));
    remember();
  };
  const remember = () => {
    const entries = Object.entries({stage: state.stage === "rooms" ? null : state.stage, pair: state.pair || null,
      view: state.view, room: state.room, storey: state.storey || null,
      colour: state.colour === "room" ? null : state.colour}).filter(e => e[1] !== null);
    history.replaceState(null, "", "#" + new URLSearchParams(entries));
  };
  const nameStorey = () =>
    at("storeyname").textContent = state.storey ? data.storeys[state.storey - 1].name : "all";

  if (colours[wanted.get("colour")]) state.colour = wanted.get("colour");
  if (data.stages[wanted.get("stage")]) state.stage = wanted.get("stage");
  state.pair = Math.min(Math.max(0, parseInt(wanted.get("pair")) || 0), ((data.stages.matches || {}).pairs || [0]).length - 1);
  state.storey = Math.min(data.storeys.length, Math.max(0, parseInt(wanted.get("storey")) || 0));
  at("colour").value = state.colour;
  at("storey").max = data.storeys.length;
  at("storey").value = state.storey;
  at("rooms").replaceChildren(...data.rooms.map(r => {
    const button = document.createElement("button"), swatch = document.createElement("span");
    button.type = "button"; button.dataset.room = r.id;
    swatch.className = "swatch"; swatch.style.background = r.colour;
    button.append(swatch, String(r.id));
    button.onclick = () => select(r.id);
    return button;
  }));
  at("stages").hidden = !Object.keys(data.stages).length;
  at("stage").replaceChildren(...Object.entries(data.stages).map(([name, stage]) =>
    new Option(titles[name] + (stage.missing ? " (not here)" : ""), name, false, name === state.stage)));
  at("pair").replaceChildren(...((data.stages.matches || {}).pairs || []).map((pair, k) =>
    new Option(pair.name, String(k), false, k === state.pair)));
  const nameStage = () => {
    const stage = stageOf();
    at("stagenote").textContent = stage.missing ? `Not here: ${stage.missing}.` : stage.note || "";
    at("pair").hidden = state.stage !== "matches" || !!stage.missing;
    at("colours").hidden = at("graphs").hidden = state.stage !== "rooms";
    at("uppers").hidden = !!stage.pairs;
    at("flat").hidden = !stage.matrixPlot;
    document.body.dataset.stage = state.stage;
    if (stage.sees) document.body.dataset.seen = String(storey.reduce((sum, _, i) => sum + stage.sees(i), 0));
    legend();
  };
  nameStage(); nameStorey();
  if (wanted.has("room")) select(parseInt(wanted.get("room")));

  const problem = text => {
    at("problem").hidden = false;
    at("problem").textContent = text;
    document.body.dataset.state = "failed";
  };
  const canvas = document.createElement("canvas");
  if (!canvas.getContext("webgl2") && !canvas.getContext("webgl")) {
    problem("This browser offers no WebGL, so the scene cannot be drawn; the rooms are listed beside.");
    return;
  }
  const axis = title => ({title: {text: title}, backgroundcolor: "#fff", gridcolor: "#e0e4e9", showspikes: false});
  const traces = parts.map(part => ({...(part.trace ? part.trace() : makers[part.kind](part)), visible: shown(part)}));
  const layout = {margin: {l: 0, r: 0, t: 0, b: 0}, uirevision: "keep",
    scene: {aspectmode: "data", xaxis: axis("x (m)"), yaxis: axis("y (m)"), zaxis: axis("z (m)"),
      camera: cameraFor(traces.filter(trace => trace.visible), at("plot"))}};
  const which = kind => parts.flatMap((part, k) => part.kind === kind ? [k] : []);
  const recolour = () => {
    const points = which("points");
    if (points.length) Plotly.restyle("plot", {"marker.size": pointSize(),
      "marker.color": points.map(k => parts[k].rows.map(pointColour))}, points);
  };
  let matrixDrawn = false;
  const drawMatrix = () => {
    if (matrixDrawn || !stageOf().matrixPlot) return;
    matrixDrawn = true;
    Plotly.newPlot("flat", ...stageOf().matrixPlot(), {responsive: true, displayModeBar: false});
  };
  const look = eye => {
    const stage = stageOf();
    if (state.stage !== "isovist" || !stage.choose(eye)) return;
    state.view = eye;
    for (const k of which("eyes").filter(k => parts[k].stage === "isovist")) {
      const {size, color} = parts[k].look(parts[k].ids);
      Plotly.restyle("plot", {"marker.size": [size], "marker.color": [color]}, [k]);
    }
    const ring = which("ring"), places = parts[ring[0]].ring();
    Plotly.restyle("plot", {x: [places.x], y: [places.y], z: [places.z]}, ring);
    recolour(); legend(); remember();
  };
  const redraw = () => Plotly.restyle("plot", {visible: parts.map(shown)});
  Plotly.newPlot("plot", traces, layout, {responsive: true, displaylogo: false}).then(plot => {
    document.body.dataset.state = "drawn";
    document.body.dataset.traces = String(plot.data.length);
    drawMatrix();
    plot.on("plotly_click", event => {
      const point = event.points[0];
      if (point.data.meta === "eyes") look(point.customdata); else select(point.customdata);
    });
    const refit = () =>
      Plotly.relayout("plot", {"scene.camera": cameraFor(traces.filter((_, k) => shown(parts[k])), at("plot"))});
    at("stage").onchange = event => {
      const pairs = [state.stage, event.target.value].includes("matches");
      state.stage = event.target.value; nameStage(); remember(); redraw(); recolour(); drawMatrix();
      if (pairs) refit();
    };
    at("pair").onchange = event => { state.pair = Number(event.target.value); remember(); redraw(); refit(); };
    at("storey").oninput = event => {
      state.storey = Number(event.target.value); nameStorey(); remember(); redraw();
    };
    at("upper").onchange = redraw;
    at("graph").onchange = redraw;
    at("colour").onchange = event => {
      state.colour = event.target.value; legend(); remember();
      recolour();
    };
  }).catch(error => problem(String(error)));
})();
