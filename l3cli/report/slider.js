// Overlays two pictures of a frame, with a slider between them. If scripts are disabled, all pictures are shown side by side.
for (const block of document.querySelectorAll(".comparison")) {
  const [other, cut] = block.querySelectorAll("select, input");
  const panes = [...block.querySelectorAll(".panes figure")];
  const divide = () => {
    block.style.setProperty("--cut", cut.value + "%");
    cut.setAttribute("aria-valuetext", `${cut.value} % ${cut.dataset.first}`);
  };
  const choose = () => panes.forEach((pane, index) => {
    pane.classList.toggle("over", index === 0);
    pane.classList.toggle("under", index === Number(other.value));
  });
  const drag = (event) => {
    if (event.buttons !== 1) return;
    const area = panes[0].querySelector("img").getBoundingClientRect();
    cut.value = Math.round(100 * (event.clientX - area.left) / area.width);
    divide();
  };
  cut.addEventListener("input", divide);
  other.addEventListener("change", choose);
  for (const kind of ["pointerdown", "pointermove"]) block.querySelector(".panes").addEventListener(kind, drag);
  block.querySelectorAll("img").forEach((image) => { image.draggable = false; });
  block.querySelectorAll(".controls").forEach((row) => { row.hidden = false; });
  block.classList.add("live");
  choose();
  divide();
}
