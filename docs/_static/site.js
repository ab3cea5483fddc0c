// Names for controls that the theme leaves without one, for readers of screens.
document.addEventListener("DOMContentLoaded", () => {
  for (const fold of document.querySelectorAll("nav summary:not([aria-label])")) {
    fold.setAttribute("aria-label", "pages of this section");
  }
  for (const link of document.querySelectorAll(".sphx-glr-thumbcontainer a:not([aria-label])")) {
    link.setAttribute("aria-label", link.textContent.trim());
  }
});
