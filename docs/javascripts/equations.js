// Equations of a page: arithmatex leaves their TeX in elements of this class.
for (const element of document.querySelectorAll(".arithmatex")) {
  const display = element.tagName === "DIV";
  katex.render(element.textContent.trim().slice(2, -2), element, { displayMode: display });
}
