"""Rules for valid requests that the OpenAPI document cannot express."""

import time

import requests
import schemathesis

# Time in which a gripper is connected again.
CONNECTED_WITHIN_S = 10

# Header fields, and the body fields with the same meaning.
SAME = {"idempotency-key": "request_id", "wsg-lease": "lease"}


@schemathesis.hook
def before_call(context, case, kwargs):
    """Removes a header that is also in the body or query, because the gateway refuses different values."""
    if not case.meta.generation.mode.is_positive:
        return
    given = {**(case.body if isinstance(case.body, dict) else {}), **(case.query or {})}
    for header in list(case.headers or {}):
        if SAME.get(header.lower()) in given:
            del case.headers[header]


@schemathesis.hook
def filter_body(context, body):
    """Leaves out the body `null`, which the gateway takes for an empty one, and adapters that need more than a request."""
    return body is not None and not needs_configuration(body)


def needs_configuration(body):
    """Whether a servo session needs a configured script, or a force that only some adapters need."""
    adapter = body.get("adapter") if isinstance(body, dict) else None
    return adapter == "script" or adapter == "position_pd" and body.get("force_n") is None


@schemathesis.hook
def filter_case(context, case):
    """Leaves out the same bodies also among invalid requests, and tickets, which an open gateway does not look at."""
    return case.body is not None and "ticket" not in (case.query or {}) and not needs_configuration(case.body)


@schemathesis.hook
def after_call(context, case, response):
    """Connects a released gripper again, since no other operation can use it."""
    request = response.request
    if not case.path.endswith("/disconnect") or response.status_code != 200:
        return
    gripper = request.url.split("?")[0].removesuffix("/disconnect")
    lease = case.body.get("lease") if isinstance(case.body, dict) else None
    headers = {"Wsg-Lease": lease or request.headers.get("Wsg-Lease", "")}
    headers |= {name: value for name, value in request.headers.items() if name == "Authorization"}
    requests.post(f"{gripper}/connect", headers=headers, timeout=CONNECTED_WITHIN_S).raise_for_status()
    deadline = time.monotonic() + CONNECTED_WITHIN_S
    while requests.get(f"{gripper}/state", headers=headers, timeout=CONNECTED_WITHIN_S).json()["link"] != "connected":
        assert time.monotonic() < deadline, f"{gripper} is not connected again"
        time.sleep(0.01)
