//! Input and result of each planning cycle: reference line, candidates, the committed path and its fallback stop.
//!
//! Candidates are coloured by result: chosen, higher cost, infeasible. A label at the end of the chosen one shows its
//! cost by terms, and below it that of the runner-up, so that the deciding terms can be read; there is one label for
//! each reason of rejection.

use std::collections::BTreeMap;

use rerun::Points2D;

use super::style::{self, order, pixels, strips};
use super::text::cost_by_terms;
use super::{Context, RecordingError};
use crate::geometry::Point;
use crate::planner::{Candidate, Cycle, Decision, Rejection};
use crate::plot::outline::footprint;
use crate::plot::refusal;

/// Number of points per candidate: its shape is smooth, and there are many of them.
const CANDIDATE_POINTS: f64 = 32.0;
/// Spacing of points along the committed path, m.
const PLAN_SPACING: f64 = 0.5;

/// Logs every planning cycle.
pub(super) fn log(context: &Context) -> Result<(), RecordingError> {
    context.run.cycles.iter().try_for_each(|cycle| {
        context.set_time(cycle.plan.time);
        log_cycle(context, cycle)
    })
}

/// Logs one cycle at the current time of the stream.
fn log_cycle(context: &Context, cycle: &Cycle) -> Result<(), RecordingError> {
    // where the plan continues without a search, those of the last search stay
    if cycle.plan.decision != Decision::Continue {
        let reference = vec![context.line(&cycle.trace.reference)];
        context.log("map/plan/reference", &strips(reference, style::REFERENCE, pixels(0.6), order::REFERENCE))?;
        log_candidates(context, cycle)?;
    }
    let plan = &cycle.plan.trajectory;
    let (from, to) = (plan.profile.at(cycle.plan.time - plan.start_time).station, plan.profile.last().station);
    let ahead: Vec<Point> = (plan.path.sampled(PLAN_SPACING).iter())
        .filter(|(station, _)| (from..=to).contains(station))
        .map(|(_, p)| p.pose.position)
        .collect();
    let stop = plan.path.at(to).pose;
    let line: Vec<Point> =
        std::iter::once(plan.path.at(from).pose.position).chain(ahead).chain([stop.position]).collect();
    context.log("map/plan/committed", &strips(vec![context.line(&line)], style::PLAN, pixels(1.6), order::PLAN))?;
    let print = footprint(context.run.vehicle, &stop).iter().map(|part| context.ring(part)).collect();
    context.log("map/plan/fallback_stop", &strips(print, style::FALLBACK_STOP, pixels(1.2), order::PLAN))
}

fn log_candidates(context: &Context, cycle: &Cycle) -> Result<(), RecordingError> {
    let line = |c: &Candidate| {
        let points = c.path.sampled((c.path.length() / CANDIDATE_POINTS).max(0.5));
        context.line(&points.iter().map(|(_, p)| p.pose.position).collect::<Vec<_>>())
    };
    let chosen = cycle.trace.chosen.and_then(|i| cycle.trace.candidates.get(i));
    let all = || cycle.trace.candidates.iter();
    let accepted = all().filter(|c| refusal(c).is_none()).map(line).collect();
    let rejected = all().filter(|c| refusal(c).is_some()).map(line).collect();
    let chosen = chosen.map(line).into_iter().collect();
    context.log("map/plan/candidates/rejected", &strips(rejected, style::REJECTED, pixels(0.5), order::REJECTED))?;
    context.log("map/plan/candidates/accepted", &strips(accepted, style::ACCEPTED, pixels(0.7), order::CANDIDATES))?;
    context.log("map/plan/candidates/chosen", &strips(chosen, style::CHOSEN, pixels(1.2), order::CANDIDATES))?;
    log_costs(context, cycle)?;
    let (places, labels) = rejection_labels(context, &cycle.trace.candidates);
    let points = Points2D::new(places).with_radii([pixels(1.5)]).with_colors([style::STOP_LINE]);
    context.log("map/plan/candidates/reasons", &points.with_labels(labels).with_draw_order(order::LABELS))
}

/// Labels the end of the chosen candidate with its cost by terms, and with that of the runner-up.
fn log_costs(context: &Context, cycle: &Cycle) -> Result<(), RecordingError> {
    let chosen = cycle.trace.chosen.and_then(|i| cycle.trace.candidates.get(i));
    let alternatives = cycle.trace.candidates.iter().filter(|c| c.rejected == Some(Rejection::HigherCost));
    let runner_up = alternatives.min_by(|a, b| a.cost.total_cmp(&b.cost));
    let label = |c: &Candidate| {
        let next = runner_up.map(|r| format!("\nrunner-up {}", cost_by_terms(r))).unwrap_or_default();
        let place = context.local(&c.path.at(c.path.length()).pose.position)?;
        Some((place, format!("chosen {}{next}", cost_by_terms(c))))
    };
    let (places, labels): (Vec<_>, Vec<_>) = chosen.and_then(label).into_iter().unzip();
    let points = Points2D::new(places).with_radii([pixels(1.5)]).with_colors([style::CHOSEN]);
    context.log("map/plan/candidates/costs", &points.with_labels(labels).with_draw_order(order::LABELS))
}

/// One label for each reason of rejection, on the middle candidate with that reason: a label on each candidate would
/// hide the road. The labels are at different stations, since candidates meet again at their ends.
fn rejection_labels(context: &Context, candidates: &[Candidate]) -> (Vec<[f32; 2]>, Vec<String>) {
    let mut by_reason: BTreeMap<&str, Vec<&Candidate>> = BTreeMap::new();
    for candidate in candidates {
        if let Some(reason) = refusal(candidate) {
            by_reason.entry(reason).or_default().push(candidate);
        }
    }
    let reasons = by_reason.len() as f64;
    (by_reason.iter().enumerate())
        .filter_map(|(i, (reason, group))| {
            let path = &group[group.len() / 2].path;
            let part = 0.35 + 0.5 * (i as f64 + 0.5) / reasons;
            let place = context.local(&path.at(part * path.length()).pose.position)?;
            Some((place, if group.len() > 1 { format!("{reason} ×{}", group.len()) } else { (*reason).to_owned() }))
        })
        .unzip()
}
