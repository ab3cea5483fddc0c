/* How the site's search ranks: Sphinx finds the pages that have all words, and this orders them by their headings.

   A result opens at the heading of its page that says most of what was asked. A word that few headings have counts more
   than one that many have; one that stands only in the title of the page counts less, and one in its text nothing. */
var Scorer = {
  // What pages are put behind others by, of equal headings: the name of each, and what it costs.
  behind: BEHIND,
  // Sphinx's own scores; `score` takes only those of names of the reference.
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: {0: 15, 1: 5, 2: -5},
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,

  stems(text) {
    const stemmer = new Stemmer();
    return [...new Set((text.toLowerCase().match(/[\p{L}\p{N}]+/gu) ?? []).map((word) => stemmer.stemWord(word)))];
  },

  // Headings by the number of their page, each with its anchor and its stems; in how many of them a stem stands.
  read() {
    const {alltitles, docnames} = Search._index;
    Scorer.headings = docnames.map(() => []);
    Scorer.counts = new Map();
    for (const [text, places] of Object.entries(alltitles)) {
      const stems = Scorer.stems(text);
      for (const stem of stems) Scorer.counts.set(stem, (Scorer.counts.get(stem) ?? 0) + places.length);
      for (const [page, anchor] of places) Scorer.headings[page].push({text, anchor, stems});
    }
    Scorer.total = Scorer.headings.flat().length;
  },

  // Small words count a quarter.
  weight(stem) {
    return Math.log(1 + Scorer.total / (1 + (Scorer.counts.get(stem) ?? 0))) * (stopwords.has(stem) ? 0.25 : 1);
  },

  // Between 0 and 1: which share of the first stems the second ones have.
  share(stems, others) {
    const sum = (each) => each.reduce((total, stem) => total + Scorer.weight(stem), 0);
    return sum(stems.filter((stem) => others.includes(stem))) / (sum(stems) || 1);
  },

  place(page) {
    return -(Scorer.behind[page] ?? Scorer.behind[page.split("/")[0]] ?? 0);
  },

  score(result) {
    const [page, , , , score, , kind] = result;
    if (kind === "object") return score + Scorer.place(page);
    if (!Scorer.headings) Scorer.read();
    const asked = Scorer.stems(new URLSearchParams(location.search).get("q") ?? "");
    const number = Search._index.docnames.indexOf(page), title = Search._index.titles[number];
    const near = Scorer.stems(title), headings = Scorer.headings[number];
    const all = headings.flatMap(({stems}) => stems);
    let value = 0, best = null;
    for (const heading of headings) {
      const own = Scorer.share(asked, heading.stems);
      if (own === 0) continue;
      const points = 60 * own + 15 * Scorer.share(asked, [...heading.stems, ...near]) + 15 * Scorer.share(asked, all)
        + 10 * Scorer.share(heading.stems, asked);
      if (points > value) [value, best] = [points, heading];
    }
    if (best && best.text !== title) {
      result[1] = `${title} > ${best.text}`;
      result[2] = `#${best.anchor}`;
    }
    return value + Scorer.place(page);
  },
};
