// Support for measurements: moving grippers, and the browser's own figures.

export const sleep = (ms) =>
  new Promise((resolve) => {
    setTimeout(resolve, ms);
  });

/** Moves a gripper to and fro, with rests between `rest()` and `goOn()`, until `end()`. */
export function keepMoving({ ask }, name) {
  let goesOn = true;
  let resting = null;
  let wake = null;
  const goOn = () => {
    wake?.();
    [resting, wake] = [null, null];
  };
  const done = (async () => {
    const post = (what, body) => ask('POST', `grippers/${name}/${what}`, body);
    await post('home', {});
    for (let turn = 0; goesOn; turn += 1) {
      await post('move', { width_mm: turn % 2 ? 20 : 100, speed_mm_s: 60 });
      await resting;
    }
  })();
  return {
    rest: () => {
      resting ??= new Promise((resolve) => {
        wake = resolve;
      });
    },
    goOn,
    end: () => {
      goesOn = false;
      goOn();
      return done;
    },
  };
}

/** Processor time by type of process. */
export async function cpuSeconds({ send }) {
  const { processInfo } = await send('SystemInfo.getProcessInfo');
  const byType = {};
  for (const { type, cpuTime } of processInfo) byType[type] = (byType[type] ?? 0) + cpuTime;
  return byType;
}

export async function heapBytes({ ask }) {
  // Twice, because finalizers release memory only for the second collection.
  for (let count = 0; count < 2; count += 1) await ask('HeapProfiler.collectGarbage');
  return (await ask('Runtime.getHeapUsage')).usedSize;
}

export const percent = (value) => `${(value * 100).toFixed(1)} %`;
