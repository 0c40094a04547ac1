// Answers arrive in any order; the page shows the one to the newest request.

/** Returns a function to call for each request. Its result checks whether that request is still the newest. */
export function numbered() {
  let newest = 0;
  return () => {
    newest += 1;
    const mine = newest;
    return () => mine === newest;
  };
}
