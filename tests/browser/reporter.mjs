// Prints one line per test, and the sum in the form that tests/run counts.

export default async function* reporter(events) {
  let passed = 0;
  let failed = 0;
  let ignored = 0;
  for await (const { type, data } of events) {
    if (type === 'test:stdout' || type === 'test:stderr') yield data.message;
    if (type === 'test:diagnostic' && data.level !== 'info') yield `# ${data.message}\n`;
    // The runner also reports each file as a test.
    if (data.details?.type === 'suite' || !/^test:(pass|fail)$/.test(type)) continue;
    const isFile = data.name.endsWith('.mjs');
    if (data.skip !== undefined || data.todo !== undefined) {
      ignored += 1;
    } else if (type === 'test:pass') {
      if (isFile) continue;
      passed += 1;
      yield `test ${data.name} ... ok (${Math.round(data.details.duration_ms)} ms)\n`;
    } else {
      failed += 1;
      const { cause, message } = data.details.error;
      yield `test ${data.name} ... FAILED\n${cause?.stack ?? message}\n`;
    }
  }
  yield `\ntest result: ${failed === 0 ? 'ok' : 'FAILED'}. ${passed} passed; ${failed} failed; ${ignored} ignored\n`;
}
