// Elements of the page, and documents from the server.

/** @type {(id: string) => any} */
export const $ = id => document.getElementById(id);

export async function json(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
}
