// Saves a plot with its legend as an SVG file, in the colours of a white page. If scripts are disabled, readers can only save CSV.
{
  const [sheet] = document.styleSheets;
  const paper = sheet.cssRules[0].style;
  const rules = [...sheet.cssRules].filter((rule) => rule.selectorText?.startsWith("svg ")).map((rule) => rule.cssText);
  const plain = (text) => text.replace(/var\((--\w+)\)/g, (_, name) => paper.getPropertyValue(name).trim())
    .replaceAll("currentColor", paper.getPropertyValue("--ink").trim());
  const legend = (figure, drawing, width, top) => {
    let [x, y] = [8, top];
    for (const key of figure.querySelectorAll(".legend li")) {
      const needed = 44 + 7 * key.textContent.trim().length;
      if (x > 8 && x + needed > width) [x, y] = [8, y + 18];
      const mark = key.querySelector("svg").cloneNode(true);
      mark.setAttribute("x", x);
      mark.setAttribute("y", y - 10);
      const text = document.createElementNS(drawing.namespaceURI, "text");
      text.setAttribute("x", x + 33);
      text.setAttribute("y", y);
      text.textContent = key.textContent.trim();
      drawing.append(mark, text);
      x += needed;
    }
    return y + 10;
  };
  const file = (figure) => {
    const drawing = figure.querySelector("svg[role=img]").cloneNode(true);
    const [, , width, height] = drawing.getAttribute("viewBox").split(" ").map(Number);
    const wide = Math.max(width, 440);
    const whole = figure.querySelector(".legend") ? legend(figure, drawing, wide, height + 16) : height;
    drawing.setAttribute("viewBox", `0 0 ${wide} ${whole}`);
    drawing.setAttribute("width", wide);
    drawing.setAttribute("height", whole);
    const style = document.createElementNS(drawing.namespaceURI, "style");
    style.textContent = `svg { font-family: system-ui, sans-serif; background: var(--paper) } ${rules.join(" ")}`;
    drawing.prepend(style);
    return plain(new XMLSerializer().serializeToString(drawing));
  };
  for (const button of document.querySelectorAll("button[data-file]")) {
    button.hidden = false;
    button.addEventListener("click", () => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([file(button.closest("figure"))], { type: "image/svg+xml" }));
      link.download = button.dataset.file;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    });
  }
}
