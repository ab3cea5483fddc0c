// Names for controls that the theme leaves without one, for readers of screens.
document.addEventListener("DOMContentLoaded", () => {
  for (const fold of document.querySelectorAll("nav summary:not([aria-label])")) {
    fold.setAttribute("aria-label", "pages of this section");
  }
  for (const link of document.querySelectorAll(".sphx-glr-thumbcontainer a:not([aria-label])")) {
    link.setAttribute("aria-label", link.textContent.trim());
  }
  // The name of an option stays whole where a long command goes on in the next line.
  for (const command of document.querySelectorAll(".highlight-sh pre")) {
    const walk = document.createTreeWalker(command, NodeFilter.SHOW_TEXT), texts = [];
    while (walk.nextNode()) texts.push(walk.currentNode);
    for (const text of texts) {
      const parts = text.data.split(/(--[a-z-]+)/);
      if (parts.length < 2) continue;
      text.replaceWith(...parts.map((part, k) => {
        const piece = document.createElement("span");
        piece.textContent = part;
        if (k % 2) piece.style.whiteSpace = "nowrap";
        return piece;
      }));
    }
  }
});
