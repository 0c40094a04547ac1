//! Orders: their operations, and the leases that they take.

use std::collections::btree_map::Entry;
use std::sync::Arc;

use futures_util::FutureExt as _;
use futures_util::future::BoxFuture;
use serde_json::{Map, Value, json};

use super::super::image::{Ended, number_of};
use super::super::order::ModbusOrder;
use super::pending::{OrderKind, OrderStep, Target};
use super::{ClientLease, ModbusConnection};
use crate::connections::admission::Class;
use crate::gripper::{AcquiredLease, Handle};
use crate::model::clock;
use crate::model::{LeaseToken, LossCause, Name, TakeLease};
use crate::operations::gripper::{fast_stop, lease, motion};
use crate::operations::{Caller, Code, ConnectionLease, Effect, Method, OperationReply, call};

impl ModbusConnection {
    /// Returns the client of a request with its rights, which a reload can change.
    fn caller(&self) -> Caller {
        Caller::new(self.client.clone(), self.settings.now().peers.operator(self.peer))
    }

    /// Whether the client may move a gripper, which a reload can change.
    pub(super) fn may_move(&self, gripper: &Name) -> bool {
        self.settings.now().peers.may_move(self.peer, gripper)
    }

    /// Requests a FAST STOP, which runs to its end even if the connection ends.
    pub(super) fn fast_stop(&mut self, target: &Target) {
        // A FAST STOP itself never waits.
        self.delay_next(self.pace.fast_stop_due(clock::instant().into()));
        let gateway = self.context.gateway.clone();
        let caller = self.caller();
        let mut params = Map::from_iter([("reason".to_owned(), json!("Modbus"))]);
        if let Target::Gripper(gripper) = target {
            params.insert("gripper".to_owned(), json!(gripper.name()));
        }
        // A refusal is recorded, and a panic logged.
        let stopping =
            tokio::spawn(
                async move { call(&gateway, caller, Method::from(&fast_stop::ALL), Value::Object(params)).await },
            );
        self.begin(stopping.map(|_| OrderStep::Finished).boxed());
    }

    pub(super) fn order(&mut self, gripper: &Handle, number: u64, order: ModbusOrder) {
        let target = Target::Gripper(gripper.clone());
        let (method, fields, moves) = match self.method(gripper, order) {
            Ok(method) => method,
            Err(problem) => return self.image(&target).ended(number, Ended::refused(problem)),
        };
        let gateway = self.context.gateway.clone();
        let mut caller = self.caller();
        let held = self.held_token(gripper);
        // A motion that is being admitted can have taken the lease.
        let claimed = self.claiming.contains_key(gripper.name()).then(|| self.token.clone());
        let token = held.clone().or(claimed).or_else(|| moves.then(|| self.token.clone()));
        let claims = moves && held.is_none();
        let kind = match &token {
            Some(token) if moves => OrderKind::Motion { token: token.clone(), claims },
            _ if method == Method::from(&lease::RELEASE) => OrderKind::ReleasesLease,
            _ => OrderKind::Other,
        };
        if claims {
            *self.claiming.entry(gripper.name().clone()).or_default() += 1;
        }
        caller.lease = Ok(token);
        let mut params = fields.as_object().cloned().unwrap_or_default();
        params.insert("gripper".to_owned(), json!(gripper.name()));
        let gripper = gripper.clone();
        let ended = async move {
            let result = call(&gateway, caller, method, Value::Object(params)).await;
            OrderStep::Ended { gripper, number, kind, result }
        };
        self.begin(ended.boxed());
    }

    /// Token of the lease that this connection holds.
    pub(super) fn held_token(&self, gripper: &Handle) -> Option<LeaseToken> {
        let held = self.leases.get(gripper.name()).filter(|held| held.lease.is_held())?;
        Some(held.lease.token().clone())
    }

    /// Returns the method of an order with its parameters, and whether it moves the fingers.
    fn method(&mut self, gripper: &Handle, order: ModbusOrder) -> Result<(Method, Value, bool), Code> {
        let state = gripper.state();
        Ok(match order {
            ModbusOrder::Motion { method, fields } => (method, fields, true),
            ModbusOrder::Jog { opens, speed_mm_s } => {
                let stroke_mm = gripper.info().stroke_mm.ok_or(Code::LinkDown)?;
                let width_mm = if opens { stroke_mm } else { 0.0 };
                ((&motion::MOVE).into(), json!({"width_mm": width_mm, "speed_mm_s": speed_mm_s}), true)
            }
            ModbusOrder::StopOrAcknowledge if state.latch.is_some() => {
                let number = self.image(&Target::Gripper(gripper.clone())).seen();
                return self.method(gripper, ModbusOrder::Acknowledge { number });
            }
            ModbusOrder::Stop | ModbusOrder::StopOrAcknowledge => ((&motion::STOP).into(), json!({}), false),
            ModbusOrder::Acknowledge { number } => match &state.latch {
                Some(latch) if number_of(latch) == number => {
                    ((&fast_stop::ACKNOWLEDGE).into(), json!({"fast_stop_id": latch.fast_stop_id}), false)
                }
                None if number == 0 => ((&fast_stop::ACKNOWLEDGE).into(), json!({}), false),
                // Acknowledged already, or a newer one.
                _ => return Err(Code::StaleFastStop),
            },
            ModbusOrder::TakeLease(terms) => ((&lease::TAKE).into(), terms, false),
            ModbusOrder::ReleaseLease => ((&lease::RELEASE).into(), json!({}), false),
        })
    }

    /// Polls an order at once, so that the gripper receives a client's orders in sequence.
    fn begin(&mut self, mut step: BoxFuture<'static, OrderStep>) {
        match (&mut step).now_or_never() {
            Some(step) => self.take(step),
            None => self.under_way.push(step),
        }
    }

    pub(super) fn take(&mut self, step: OrderStep) {
        match step {
            OrderStep::Finished => {}
            OrderStep::Ended { gripper, number, kind, result } => {
                let image = self.image(&Target::Gripper(gripper.clone()));
                let leased = match result {
                    Ok(OperationReply { effect: Effect::Running { ticket, .. }, .. }) => {
                        image.admitted(number, ticket.watched());
                        None
                    }
                    Ok(OperationReply { effect: Effect::Leased(lease), .. }) => {
                        image.ended(number, Ended::done());
                        Some(lease)
                    }
                    Ok(reply) => {
                        image.ended(number, Ended::of_reply(reply.body.get()));
                        None
                    }
                    Err(problem) => {
                        image.ended(number, Ended::refused(problem.code()));
                        None
                    }
                };
                match kind {
                    OrderKind::Motion { token, claims } => self.keep(&gripper, token, claims),
                    OrderKind::ReleasesLease => drop(self.leases.remove(gripper.name())),
                    OrderKind::Other => {}
                }
                self.hold(&gripper, leased);
            }
            OrderStep::Kept { gripper, claims, acquired } => {
                if let Entry::Occupied(mut claiming) = self.claiming.entry(gripper.name().clone())
                    && claims
                {
                    *claiming.get_mut() -= 1;
                    if *claiming.get() == 0 {
                        claiming.remove();
                    }
                }
                if let Some(AcquiredLease { lease, times_taken, keep }) = acquired.map(|acquired| *acquired) {
                    self.hold(&gripper, ConnectionLease::new(gripper.clone(), &lease, times_taken, keep).map(Arc::new));
                }
            }
        }
    }

    fn hold(&mut self, gripper: &Handle, lease: Option<Arc<ConnectionLease>>) {
        if let Some(lease) = lease {
            // A reload can have taken the right away while the lease was being taken.
            if !self.may_move(gripper.name()) {
                return self.lose(lease, LossCause::Forbidden);
            }
            let pin = self.permit.claim(Class::Pinned);
            self.leases.insert(gripper.name().clone(), ClientLease { lease, _pin: pin });
        }
    }

    /// Keeps the lease that a motion has taken with this token, unless it is kept already.
    fn keep(&mut self, gripper: &Handle, token: LeaseToken, claims: bool) {
        if !claims && self.held_token(gripper).as_ref() == Some(&token) {
            return;
        }
        let take = TakeLease { token: Some(token), ..TakeLease::by(self.client.clone()) };
        let gripper = gripper.clone();
        let kept = async move {
            // Fails if the motion was refused, or if another client has just forced the lease away.
            let acquired = gripper.take_lease(take).await.ok().map(Box::new);
            OrderStep::Kept { gripper, claims, acquired }
        };
        self.begin(kept.boxed());
    }

    /// Reports that a lease's holder is lost, without waiting for the gripper.
    pub(super) fn lose(&mut self, lease: Arc<ConnectionLease>, cause: LossCause) {
        let lost = async move {
            lease.lose(cause).await;
            OrderStep::Finished
        };
        self.begin(lost.boxed());
    }
}
