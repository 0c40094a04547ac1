// Answers arrive in any order; the page shows the one to the newest request that was answered.

/** Returns a function to call for each request. Its result checks whether that request is still the newest. */
export function numbered() {
  let newest = 0;
  return () => {
    newest += 1;
    const mine = newest;
    return () => mine === newest;
  };
}

/**
 * Returns a function to call for each request. Its result is to be called with an answer, and checks whether no newer
 * request was answered before.
 */
export function ordered() {
  let sent = 0;
  let answered = 0;
  return () => {
    sent += 1;
    const mine = sent;
    return () => {
      if (mine < answered) return false;
      answered = mine;
      return true;
    };
  };
}
