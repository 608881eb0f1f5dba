// Lists all classes of a table, including classes that do not occur in the crop, and shows the selected class (see pixels.js).
const share = (view, layer, index) => {
  const part = (100 * (layer.pixels[index] ?? 0)) / (view.frame[0] * view.frame[1]);
  return part && part < 0.01 ? "below 0.01 %" : `${part.toFixed(2)} %`;
};

function chosenFrom(title, names) {
  const list = document.createElement("select");
  list.append(...names.map((name, number) => new Option(name, number)));
  return [list, written("label", `${title} `, list)];
}

// Returns the entry for a class in the list: its percentage of the frame, then the features in which classes of the layer differ.
function listed(view, layer, index) {
  const words = Object.entries(layer.classes[index]).filter(([name]) => layer.varying.has(name));
  return [share(view, layer, index), ...words.map(([name, text]) => `${name} ${text}`)].join(" · ");
}

function browse(block, view) {
  const sites = view.cfa.flatMap((row, down) => row.map((channel, across) => `(${down}, ${across}) ${view.channels[channel]}`));
  const [layers, layerLabel] = chosenFrom("Layer", view.layers.map((_, number) => layerTitle(number)));
  const [places, placeLabel] = chosenFrom("Site", sites);
  const [classes, classLabel] = chosenFrom("Classes, sorted by their frequency in the frame", []);
  const reading = Object.assign(document.createElement("div"), { className: "reading" });
  classes.size = 10;
  layerLabel.hidden = view.layers.length === 1;
  reading.setAttribute("aria-live", "polite");
  for (const layer of view.layers) {
    const apart = (name) => new Set(layer.classes.map((each) => each[name])).size > 1;
    const names = new Set(layer.classes.flatMap(Object.keys));
    layer.varying = new Set([...names].filter((name) => !["class", "site", "training"].includes(name) && apart(name)));
  }
  const show = () => {
    const [number, index, site] = [Number(layers.value), Number(classes.value), Number(places.value)];
    const across = view.cfa[0].length;
    reading.replaceChildren(...(classes.value ? [classed(view, number, index, [Math.floor(site / across), site % across])] : []));
  };
  const list = () => {
    const layer = view.layers[Number(layers.value)];
    const here = [...layer.classes.keys()].filter((index) => layer.classes[index].site === sites[places.value]);
    here.sort((one, other) => (layer.pixels[other] ?? 0) - (layer.pixels[one] ?? 0));
    classes.replaceChildren(...here.map((index) => new Option(listed(view, layer, index), index)));
    classes.selectedIndex = 0;
    show();
  };
  layers.addEventListener("change", list);
  places.addEventListener("change", list);
  classes.addEventListener("change", show);
  block.append(written("div", layerLabel, placeLabel, classLabel), reading);
  // The list has thousands of entries, so it is created only when the reader expands this section.
  block.addEventListener("toggle", list, { once: true });
  block.hidden = false;
}
