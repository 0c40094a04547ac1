// Answers come in any order: what is shown is that to the newest question.

/** Numbers questions: each call is one, and answers whether it is still the newest. */
export function numbered() {
  let newest = 0;
  return () => {
    newest += 1;
    const mine = newest;
    return () => mine === newest;
  };
}
