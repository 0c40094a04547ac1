// Templates of the dictionaries: `{name}` is a parameter.

export function fill(template, parameters = {}) {
  return template.replace(/\{(\w+)\}/g, (whole, name) => (name in parameters ? String(parameters[name]) : whole));
}

/** Names of the parameters in a template. */
export function placeholders(template) {
  return [...new Set(Array.from(template.matchAll(/\{(\w+)\}/g), ([, name]) => name))].sort();
}
