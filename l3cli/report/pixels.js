// Shows the class and the transform of the selected pixel in each layer. The reader selects a pixel by a click or with the arrow
// keys. pixels.py encodes the data.
const drawn = (name, attributes, ...inside) => {
  const node = document.createElementNS(document.querySelector("svg").namespaceURI, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...inside);
  return node;
};
const written = (name, text, ...inside) => {
  const node = document.createElement(name);
  node.append(text, ...inside);
  return node;
};

async function unpacked(text) {
  const coded = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([coded]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = await new Response(stream).arrayBuffer();
  const length = new DataView(bytes).getUint32(0, true);
  const view = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, length)));
  let at = 4 + length;
  const next = (Kind, count) => {
    const numbers = new Kind(bytes, at, count);
    at += Math.ceil((count * Kind.BYTES_PER_ELEMENT) / 4) * 4;
    return numbers;
  };
  for (const layer of view.layers) {
    layer.taps = layer.side ** 2 * layer.planes.length;
    const rows = layer.with_weights * view.outputs.length;
    layer.largest = next(Float32Array, rows);
    layer.labels = next(Uint16Array, view.size[0] * view.size[1]);
    layer.weights = next(Int8Array, rows * layer.taps);
  }
  return view;
}

const PANEL = 117; // px; approximate side of a drawn window
const rounded = (value) => Number(value.toPrecision(2)).toString().replace("-", "−");

// Draws a window as a square of cells, with a name above it. `fill` returns the colour, the opacity and the text of each tap.
function panel(side, name, x, y, fill) {
  const cell = Math.round(PANEL / side);
  const group = drawn("g", { transform: `translate(${x} ${y})` });
  group.append(drawn("text", { x: (side * cell) / 2, y: -5, "text-anchor": "middle" }, name));
  for (let tap = 0; tap < side * side; tap += 1) {
    const [colour, opacity, words] = fill(tap);
    const place = { x: (tap % side) * cell, y: Math.floor(tap / side) * cell, width: cell, height: cell };
    group.append(drawn("rect", { ...place, fill: colour, "fill-opacity": opacity }, drawn("title", {}, words)));
  }
  const middle = Math.floor(side / 2) * cell;
  group.append(drawn("path", { class: "axis", fill: "none", d: `M0,0h${side * cell}v${side * cell}H0z` }));
  group.append(drawn("path", { class: "centre", d: `M${middle},${middle}h${cell}v${cell}h${-cell}z` }));
  return [group, side * cell];
}

// Draws the transform of a class. If the layer reads the mosaic, all windows are in one row. Otherwise, there is one row per output.
function transform(view, layer, index, site) {
  const { side, planes } = layer;
  const [mosaic, gap, items, findings] = [planes.length === 1, 12, [], []];
  const begin = mosaic ? 1 : 22;
  let [x, y, wide] = [begin, 18, 0];
  const put = (name, fill) => {
    const [group, size] = panel(side, name, x, y, fill);
    items.push(group);
    x += size + gap;
    wide = Math.max(wide, x);
    return size;
  };
  let size = 0;
  if (mosaic) {
    size = put("filters", (tap) => {
      const [down, across] = [Math.floor(tap / side), tap % side].map((place) => place - Math.floor(side / 2));
      const channel = view.channelAt(site[0] + down, site[1] + across);
      return [view.colours[channel], 1, view.channels[channel]];
    });
  }
  view.outputs.forEach((output, number) => {
    const row = index * view.outputs.length + number;
    const weight = (tap) => {
      const root = layer.weights[row * layer.taps + tap] / 127;
      return [root, Math.sign(root) * root * root * layer.largest[row]];
    };
    const all = Array.from({ length: layer.taps }, (_, tap) => weight(tap)[1]);
    const [sum, gain] = [all.reduce((a, b) => a + b, 0), Math.hypot(...all)];
    findings.push(`${output}: sum ${rounded(sum)}, noise gain ${rounded(gain)}, largest weight ${rounded(layer.largest[row])}`);
    if (!mosaic && number) [x, y] = [begin, y + size + 8];
    if (!mosaic) items.push(drawn("text", { x: 1, y: y + PANEL / 2 }, output));
    planes.forEach((plane, which) => {
      size = put(mosaic ? output : number ? "" : plane, (tap) => {
        const [root, value] = weight(which * side * side + tap);
        return [root > 0 ? "var(--two)" : "var(--one)", Math.abs(root).toFixed(2), rounded(value)];
      });
    });
  });
  const box = { viewBox: `0 0 ${wide - gap + 2} ${y + size + 2}`, width: wide - gap + 2, height: y + size + 2 };
  const legend = "Positive weights are orange, negative weights are blue. The opacity is the square root of the weight.";
  const finding = `${findings.join("; ")}. ${legend}`;
  return [drawn("svg", { ...box, role: "img", "aria-label": `Weights of the taps. ${finding}` }, ...items), finding];
}

const layerTitle = (number) => (number ? `Layer ${number + 1}, reads the outputs of layer ${number}` : "Layer 1, reads the mosaic");

// Describes a class in words, and shows its transform if the page contains the transform.
function classed(view, number, index, site) {
  const layer = view.layers[number];
  const list = document.createElement("dl");
  const words = { ...layer.classes[index], frame: `${share(view, layer, index)} of its pixels` };
  for (const [name, text] of Object.entries(words)) list.append(written("dt", name), written("dd", text));
  let figure = written("p", "This page does not contain the transform, because the class is rare in the frame or missing from it.");
  if (index < layer.with_weights) {
    const [drawing, finding] = transform(view, layer, index, site);
    figure = written("figure", drawing, written("figcaption", finding));
  }
  const block = written("div", written("h5", view.layers.length > 1 ? layerTitle(number) : "Class"), list, figure);
  block.className = "layer";
  return block;
}

function described(view, row, col) {
  const site = [row % view.cfa.length, col % view.cfa[0].length];
  const [top, left] = view.corner;
  const at = (row - top) * view.size[1] + col - left;
  const parts = [written("h4", `Row ${row}, column ${col}: site (${site.join(", ")}) ${view.channels[view.channelAt(...site)]}`)];
  view.layers.forEach((layer, number) => parts.push(classed(view, number, layer.labels[at], site)));
  return parts;
}

async function pick(block) {
  const view = await unpacked(block.querySelector("template").content.textContent);
  const mod = (value, by) => ((value % by) + by) % by;
  view.channelAt = (row, col) => view.cfa[mod(row, view.cfa.length)][mod(col, view.cfa[0].length)];
  const [[top, left], [rows, cols]] = [view.corner, view.size];
  const reading = block.querySelector(".reading");
  const views = [...block.querySelectorAll(".view")];
  const marks = views.map((each) => each.appendChild(Object.assign(document.createElement("span"), { className: "cursor" })));
  let [row, col] = [top + (rows >> 1), left + (cols >> 1)];
  const show = () => {
    for (const mark of marks) {
      mark.style.left = `${(100 * (col - left + 0.5)) / cols}%`;
      mark.style.top = `${(100 * (row - top + 0.5)) / rows}%`;
    }
    reading.replaceChildren(...described(view, row, col));
  };
  const move = (down, across) => {
    row = Math.min(Math.max(down, top), top + rows - 1);
    col = Math.min(Math.max(across, left), left + cols - 1);
    show();
  };
  for (const each of views) {
    const image = each.querySelector("img");
    each.tabIndex = 0;
    each.setAttribute("role", "application");
    each.setAttribute("aria-label", `Picture "${image.closest("figure").textContent.trim()}": select a pixel with the arrow keys`);
    each.addEventListener("click", (event) => {
      const area = image.getBoundingClientRect();
      const share = [(event.clientY - area.top) / area.height, (event.clientX - area.left) / area.width];
      move(top + Math.floor(share[0] * rows), left + Math.floor(share[1] * cols));
    });
    each.addEventListener("keydown", (event) => {
      const step = event.shiftKey ? 10 : 1;
      const way = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
      if (!way) return;
      event.preventDefault();
      move(row + step * way[0], col + step * way[1]);
    });
  }
  // The picture of the whole frame contains an outline of the crop. A click inside the outline also selects a pixel.
  const whole = document.getElementById(`with-${block.dataset.frame}`).closest(".comparison");
  const [height, width] = whole.dataset.size.split(" ").map(Number);
  for (const each of whole.querySelectorAll(".view")) {
    const outline = each.appendChild(Object.assign(document.createElement("span"), { className: "outline" }));
    const share = { left: left / width, top: top / height, width: cols / width, height: rows / height };
    for (const [name, value] of Object.entries(share)) outline.style[name] = `${100 * value}%`;
  }
  whole.querySelector(".panes").addEventListener("click", (event) => {
    const area = whole.querySelector(".under img").getBoundingClientRect();
    const down = Math.floor(((event.clientY - area.top) / area.height) * height);
    const across = Math.floor(((event.clientX - area.left) / area.width) * width);
    if (down >= top && down < top + rows && across >= left && across < left + cols) move(down, across);
  });
  reading.hidden = false;
  block.querySelector(".hint span").hidden = false;
  show();
  browse(block.querySelector(".classes"), view);
}

if ("DecompressionStream" in window) document.querySelectorAll(".pixels").forEach(pick);
