// A limit of requests in flight: the gateway refuses more than 32 on a connection, also the user's own.

/** Returns a function that runs tasks, at most `most` at a time. Further ones wait in their order. */
export function paced(most) {
  const waiting = [];
  let running = 0;
  const next = () => {
    if (running >= most || waiting.length === 0) return;
    running += 1;
    const { task, resolve, reject } = waiting.shift();
    task()
      .then(resolve, reject)
      .finally(() => {
        running -= 1;
        next();
      });
  };
  return (task) =>
    new Promise((resolve, reject) => {
      waiting.push({ task, resolve, reject });
      next();
    });
}
