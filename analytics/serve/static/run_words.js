// Words of the data on the page of a run, in the page's language.
const WORDS = JSON.parse(document.getElementById("run-control").dataset.words);

/** A word such as an outcome or a verdict as people read it. */
export function words(word) {
  return WORDS[word] ?? word;
}
