//! The HTTP statuses of the problems that operations can have.

/// Problems of a FAST STOP of one gripper, which is never refused in favour of others.
pub const FAST_STOP: &[u16] = &[400, 401, 403, 404, 422, 500];
/// Problems of a FAST STOP of several grippers.
pub const FAST_STOPS: &[u16] = &[400, 401, 403, 500];
/// Problems of every other operation.
pub const ANY: &[u16] = &[400, 401, 403, 429, 500];
/// Problems of operations that read the gateway's own knowledge of a gripper.
pub const GRIPPER: &[u16] = &[400, 401, 403, 404, 422, 429, 500];
/// Problems of operations that change the gateway's own knowledge of a gripper.
pub const KNOWLEDGE: &[u16] = &[400, 401, 403, 404, 408, 413, 415, 422, 429, 500, 503];
/// Problems of operations that ask a gripper's actor about its commands.
pub const COMMAND: &[u16] = KNOWLEDGE;
/// Problems of operations that request the lease.
pub const LEASE: &[u16] = &[400, 401, 403, 404, 408, 409, 413, 415, 422, 429, 500, 503];
/// Problems of a test of a webhook.
pub const WEBHOOK: &[u16] = &[400, 401, 403, 404, 408, 413, 415, 422, 429, 500];
/// Problems of reading the configuration again.
pub const RELOAD: &[u16] = &[400, 401, 403, 408, 409, 413, 415, 429, 500];
/// Problems of changes of recipes.
pub const RECIPE: &[u16] = &[400, 401, 403, 404, 408, 409, 412, 413, 415, 422, 429, 500, 503];
/// Problems of copying recipes to another gateway.
pub const COPY: &[u16] = RECIPE_MOTION;
/// Problems of reading the journal.
pub const JOURNAL: &[u16] = &[400, 401, 403, 404, 422, 429, 500, 503];
/// Problems of operations that send requests to the device.
pub const DEVICE: &[u16] = &[400, 401, 403, 404, 408, 409, 413, 415, 422, 429, 500, 502, 503, 504];
/// Problems of motions that can follow a recipe.
pub const RECIPE_MOTION: &[u16] = &[400, 401, 403, 404, 408, 409, 412, 413, 415, 422, 429, 500, 502, 503, 504];
