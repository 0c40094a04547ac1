"""What the description of the HTTP API cannot say of valid requests, and generated ones have to keep to."""

import schemathesis

# The header and the field of the body that mean the same.
SAME = {"idempotency-key": "request_id", "wsg-lease": "lease"}


@schemathesis.hook
def before_call(context, case, kwargs):
    """A request that names itself in the header and in the body, and differs, is refused: so one of them is enough."""
    if not case.meta.generation.mode.is_positive or not isinstance(case.body, dict):
        return
    for header in list(case.headers or {}):
        if SAME.get(header.lower()) in case.body:
            del case.headers[header]
