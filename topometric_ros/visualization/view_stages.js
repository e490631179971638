"use strict";
// What the page shows beside rooms and points: parts of the scene for every stage of the extraction.
// A part is {kind, stage, storey, trace}; storey -1 is part of all. `wanted`: the viewpoint to begin with.
const stageParts = (data, bytes, wanted) => {
  const stages = data.stages, parts = [];
  const ink = "#1d2228", eye = "#d1003f";
  const some = name => stages[name] && !stages[name].missing ? stages[name] : null;
  const base = {type: "scatter3d", showlegend: false, hoverinfo: "skip"};
  const columns = places => ({x: places.map(p => p[0]), y: places.map(p => p[1]), z: places.map(p => p[2])});
  const every = (xyz, keep) => {
    const rows = [];
    for (let i = 0; i < xyz.length / 3; i++) if (keep(i)) rows.push(i);
    const pick = k => Float32Array.from(rows, i => xyz[3 * i + k]);
    return {rows, place: {x: pick(0), y: pick(1), z: pick(2)}};
  };
  const eachStorey = make => data.storeys.forEach((_, s) => make(s));

  const cells = (stage, marker, hover) => {
    const found = some(stage);
    if (!found) return;
    const xyz = new Float32Array(bytes(found.xyz)), storey = new Uint8Array(bytes(found.storey));
    const distance = new Float32Array(bytes(found.distance));
    const most = distance.reduce((a, b) => Math.max(a, b), 0);
    eachStorey(s => {
      const {rows, place} = every(xyz, i => storey[i] === s);
      if (rows.length) parts.push({kind: "cells", stage, storey: s, trace: () => ({...base, mode: "markers",
        ...place, ...hover(rows, distance), marker: marker(found, rows.map(i => distance[i]), most)})});
    });
  };
  cells("navigable", found => ({size: 3.5, color: found.colour}), () => ({}));
  cells("distance", (found, values, most) => ({size: 3.5, color: values, colorscale: "Viridis", cmin: 0, cmax: most,
    showscale: true, colorbar: {title: {text: "to the edge (m)", side: "right"}, x: 0.01, xanchor: "left",
      len: 0.5, thickness: 14}}),
  (rows, distance) => ({hoverinfo: "text", text: rows.map(i => `${distance[i].toFixed(2)} m to the edge`)}));

  // Viewpoints of one storey; `look` gives their markers.
  const eyes = (stage, look) => {
    const found = some(stage);
    if (!found) return;
    eachStorey(s => {
      const ids = found.eyes.storey.flatMap((at, i) => at === s ? [i] : []);
      if (ids.length) parts.push({kind: "eyes", stage, storey: s, ids, look, trace: () => ({...base, mode: "markers",
        ...columns(ids.map(i => found.eyes.xyz[i])), hoverinfo: "text", customdata: ids,
        text: ids.map(i => `viewpoint ${i}`), meta: "eyes", marker: look(ids)})});
    });
  };
  eyes("distance", ids => ({size: 4, color: eye, line: {color: ink, width: 1}}));

  const isovist = some("isovist");
  if (isovist) {
    const packed = new Uint8Array(bytes(isovist.rows));
    // Rows of the points that a viewpoint sees: varints of the steps between them, less one.
    isovist.choose = view => {
      const place = isovist.of.indexOf(view);
      if (place < 0) return false;
      const start = isovist.sizes.slice(0, place).reduce((a, b) => a + b, 0);
      const rows = new Set();
      for (let k = start, row = -1, step = 0, shift = 0; k < start + isovist.sizes[place]; k++) {
        step |= (packed[k] & 127) << shift;
        shift += 7;
        if (packed[k] < 128) { row += step + 1; rows.add(row); step = shift = 0; }
      }
      isovist.chosen = view;
      isovist.sees = i => rows.has(i);
      return true;
    };
    isovist.choose(wanted) || isovist.choose(isovist.of[0]);
    eyes("isovist", ids => ({
      size: ids.map(i => i === isovist.chosen ? 10 : 4),
      color: ids.map(i => i === isovist.chosen ? eye : isovist.of.includes(i) ? "#ffffff" : "#b8b8b8"),
      line: {color: ink, width: 1}}));
    const ring = () => {
      const [x, y, z] = isovist.eyes.xyz[isovist.chosen];
      return columns(Array.from({length: 73}, (_, k) =>
        [x + isovist.radius * Math.cos(k * Math.PI / 36), y + isovist.radius * Math.sin(k * Math.PI / 36), z]));
    };
    parts.push({kind: "ring", stage: "isovist", storey: -1, ring, trace: () => ({...base, mode: "lines", ...ring(),
      line: {color: eye, width: 3}})});
  }

  const similar = some("similarity");
  if (similar) {
    const matrix = new Uint8Array(bytes(similar.matrix)), count = similar.clusters.length;
    const at = (i, j) => matrix[i * count + j] / 255;
    const blues = [[0, "#f7fbff"], [0.5, "#6baed6"], [1, "#08306b"]];
    eachStorey(s => {
      const ids = similar.eyes.storey.flatMap((k, i) => k === s ? [i] : []);
      const places = [], weights = [];
      for (const i of ids) for (const j of ids) if (i < j && at(i, j) >= similar.drawn) {
        places.push(similar.eyes.xyz[i], similar.eyes.xyz[j], [null, null, null]);
        weights.push(at(i, j), at(i, j), at(i, j));
      }
      if (places.length) parts.push({kind: "similar", stage: "similarity", storey: s, trace: () => ({...base,
        mode: "lines", ...columns(places), line: {width: 3, color: weights, cmin: 0, cmax: 1, colorscale: blues}})});
    });
    eyes("similarity", ids => ({size: 7, color: ids.map(i => similar.colours[similar.clusters[i]]),
      line: {color: ink, width: 1}}));
    // The matrix, views of a cluster side by side, with the clusters' colours along two edges.
    similar.matrixPlot = () => {
      const order = similar.order, edge = Math.max(1, 0.03 * count), shapes = [];
      for (let start = 0; start < count;) {
        let end = start;
        while (end < count && similar.clusters[order[end]] === similar.clusters[order[start]]) end++;
        const [a, b] = [start - 0.5, end - 0.5], fillcolor = similar.colours[similar.clusters[order[start]]];
        shapes.push({type: "rect", x0: a, x1: b, y0: a, y1: b, line: {color: ink, width: 1}},
          {type: "rect", x0: -0.5 - edge, x1: -0.5 - 0.25 * edge, y0: a, y1: b, fillcolor, line: {width: 0}},
          {type: "rect", x0: a, x1: b, y0: -0.5 - edge, y1: -0.5 - 0.25 * edge, fillcolor, line: {width: 0}});
        start = end;
      }
      const range = [-0.5 - edge, count - 0.5];
      const axis = {showticklabels: false, showgrid: false, zeroline: false, ticks: "", constrain: "domain"};
      return [[{type: "heatmap", zmin: 0, zmax: 1, colorscale: blues,
        z: order.map(i => order.map(j => at(i, j))), hoverinfo: "text",
        text: order.map(i => order.map(j => `viewpoints ${i} and ${j}: ${at(i, j).toFixed(2)}`)),
        colorbar: {title: {text: "Jaccard index", side: "right"}, thickness: 12, len: 0.9}}],
      {margin: {l: 8, r: 8, t: 8, b: 26}, shapes,
        xaxis: {...axis, range, title: {text: `${count} views by cluster`, font: {size: 13}, standoff: 4}},
        yaxis: {...axis, range: [range[1], range[0]], scaleanchor: "x"}}];
    };
  }

  for (const way of (some("trajectories") || {ways: []}).ways) {
    for (const leg of way.legs) parts.push({kind: "way", stage: "trajectories", storey: leg.storey, trace: () => ({
      ...base, mode: "lines", ...columns(leg.path), hoverinfo: "text", text: way.name,
      line: {color: way.colour, width: 7}})});
    const [first] = way.legs;
    parts.push({kind: "way", stage: "trajectories", storey: first.storey, trace: () => ({...base, mode: "markers",
      ...columns([first.path[0]]), hoverinfo: "text", text: `${way.name}: start`,
      marker: {size: 8, color: way.colour, line: {color: ink, width: 2}}})});
  }

  (some("matches") || {pairs: []}).pairs.forEach((pair, k) => {
    const add = trace => parts.push({kind: "pair", stage: "matches", storey: -1, pair: k, trace});
    pair.sides.forEach((side, of) => {
      const colours = new Map(pair.links.map(link => [link.rooms[of], link.colour]));
      const xyz = new Float32Array(bytes(side.xyz)), room = new Int32Array(bytes(side.room));
      const {rows, place} = every(xyz, () => true);
      add(() => ({...base, mode: "markers", ...place, hoverinfo: "text",
        text: rows.map(i => room[i] < 0 ? "no room" : `room ${room[i]} of ${side.agent}`),
        marker: {size: 2, color: rows.map(i => colours.get(room[i]) || "#c9ced4")}}));
      add(() => ({...base, mode: "text", ...columns(side.rooms.map(r => r.node)), text: side.rooms.map(r => String(r.id)),
        textposition: "top center", textfont: {size: 15, color: ink}}));
      add(() => ({...base, mode: "text", ...columns([side.label]), text: [side.agent], textfont: {size: 20, color: ink}}));
    });
    pair.links.forEach(link => add(() => ({...base, mode: "lines+markers", ...columns(link.path), hoverinfo: "text",
      text: `room ${link.rooms[0]} = room ${link.rooms[1]}`, line: {color: link.colour, width: 6},
      marker: {size: 5, color: link.colour, line: {color: ink, width: 1}}})));
  });
  return parts;
};

// A camera that holds all of some traces, in plotly's units: the box round them has the volume 1, its middle is 0.
const cameraFor = (traces, plot) => {
  const sides = ["x", "y", "z"].map(axis => {
    let low = Infinity, high = -Infinity;
    for (const trace of traces) for (const v of trace[axis]) if (v !== null) { low = Math.min(low, v); high = Math.max(high, v); }
    return Math.max(high - low, 0.1);
  });
  const direction = [0.7, -1.3, 1.6], dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const scaled = (a, by) => a.map(v => v * by), unit = a => scaled(a, 1 / Math.sqrt(dot(a, a)));
  const back = unit(direction), right = unit([-back[1], back[0], 0]);
  const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2], back[0] * right[1] - back[1] * right[0]];
  const mean = Math.cbrt(sides[0] * sides[1] * sides[2]), steep = Math.tan(Math.PI / 8);
  const wide = steep * plot.clientWidth / Math.max(plot.clientHeight, 1);
  let distance = 0.5;
  for (let k = 0; k < 8 && Number.isFinite(mean); k++) {
    const corner = sides.map((side, axis) => (k >> axis & 1 ? 0.5 : -0.5) * side / mean);
    const least = Math.max(Math.abs(dot(corner, right)) / wide, Math.abs(dot(corner, up)) / steep) + dot(corner, back);
    distance = Math.max(distance, least);
  }
  const [x, y, z] = scaled(back, distance);
  return {eye: {x, y, z}};
};
