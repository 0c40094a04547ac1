"""Rules for valid requests that the OpenAPI document cannot express."""

import schemathesis

# Header fields, and the body fields with the same meaning.
SAME = {"idempotency-key": "request_id", "wsg-lease": "lease"}


@schemathesis.hook
def before_call(context, case, kwargs):
    """Removes a header that is also in the body, because the gateway refuses different values."""
    if not case.meta.generation.mode.is_positive or not isinstance(case.body, dict):
        return
    for header in list(case.headers or {}):
        if SAME.get(header.lower()) in case.body:
            del case.headers[header]
