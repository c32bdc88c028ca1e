//! What each planning cycle saw and chose: reference line, candidates, the committed path and its proven stop.
//!
//! Candidates are coloured by what became of them: chosen, dearer, refused. At the end of the chosen one stands its cost
//! by terms, and below it that of the runner-up, so that what decided between them can be read; one label for each reason
//! of refusal stands on the way.

use std::collections::BTreeMap;

use rerun::Points2D;

use super::style::{self, order, pixels, strips};
use super::{Context, RecordingError};
use crate::geometry::Point;
use crate::planner::{Candidate, Cycle, Rejection};
use crate::plot::outline::footprint;
use crate::plot::refusal;

/// Points along a candidate: its shape is smooth, and there are many of them.
const CANDIDATE_POINTS: f64 = 32.0;
/// Spacing of points along the committed path, m.
const PLAN_SPACING: f64 = 0.5;

/// Logs every planning cycle.
pub(super) fn log(context: &Context) -> Result<(), RecordingError> {
    context.run.cycles.iter().try_for_each(|cycle| {
        context.set_time(cycle.time);
        log_cycle(context, cycle)
    })
}

/// Logs what one cycle saw and chose, at the present time of the stream.
fn log_cycle(context: &Context, cycle: &Cycle) -> Result<(), RecordingError> {
    let reference = vec![context.line(&cycle.reference)];
    context.log("map/plan/reference", &strips(reference, style::REFERENCE, pixels(0.6), order::REFERENCE))?;
    log_candidates(context, cycle)?;
    let plan = &cycle.committed;
    let (from, to) = (plan.profile.at(cycle.time - plan.start_time).station, plan.profile.last().station);
    let ahead: Vec<Point> = (plan.path.sampled(PLAN_SPACING).iter())
        .filter(|(station, _)| (from..=to).contains(station))
        .map(|(_, p)| p.pose.position)
        .collect();
    let stop = plan.path.at(to).pose;
    let line: Vec<Point> =
        std::iter::once(plan.path.at(from).pose.position).chain(ahead).chain([stop.position]).collect();
    context.log("map/plan/committed", &strips(vec![context.line(&line)], style::PLAN, pixels(1.6), order::PLAN))?;
    let print = footprint(context.run.vehicle, &stop).iter().map(|part| context.ring(part)).collect();
    context.log("map/plan/proven_stop", &strips(print, style::PROVEN_STOP, pixels(1.2), order::PLAN))
}

fn log_candidates(context: &Context, cycle: &Cycle) -> Result<(), RecordingError> {
    let line = |c: &Candidate| {
        let points = c.path.sampled((c.path.length() / CANDIDATE_POINTS).max(0.5));
        context.line(&points.iter().map(|(_, p)| p.pose.position).collect::<Vec<_>>())
    };
    let chosen = cycle.chosen.and_then(|i| cycle.candidates.get(i));
    let all = || cycle.candidates.iter();
    let accepted = all().filter(|c| refusal(c).is_none()).map(line).collect();
    let rejected = all().filter(|c| refusal(c).is_some()).map(line).collect();
    let chosen = chosen.map(line).into_iter().collect();
    context.log("map/plan/candidates/rejected", &strips(rejected, style::REJECTED, pixels(0.5), order::REJECTED))?;
    context.log("map/plan/candidates/accepted", &strips(accepted, style::ACCEPTED, pixels(0.7), order::CANDIDATES))?;
    context.log("map/plan/candidates/chosen", &strips(chosen, style::CHOSEN, pixels(1.2), order::CANDIDATES))?;
    log_costs(context, cycle)?;
    let (places, labels) = rejection_labels(context, &cycle.candidates);
    let points = Points2D::new(places).with_radii([pixels(1.5)]).with_colors([style::STOP_LINE]);
    context.log("map/plan/candidates/reasons", &points.with_labels(labels).with_draw_order(order::LABELS))
}

/// The cost by terms at the end of the chosen candidate, and below it that of the cheapest one that it was chosen before.
fn log_costs(context: &Context, cycle: &Cycle) -> Result<(), RecordingError> {
    let chosen = cycle.chosen.and_then(|i| cycle.candidates.get(i));
    let passed = cycle.candidates.iter().filter(|c| c.rejected == Some(Rejection::HigherCost));
    let runner_up = passed.min_by(|a, b| a.cost.total_cmp(&b.cost));
    let label = |c: &Candidate| {
        let next = runner_up.map(|r| format!("\ndearer {}", cost_by_terms(r))).unwrap_or_default();
        let place = context.local(&c.path.at(c.path.length()).pose.position)?;
        Some((place, format!("chosen {}{next}", cost_by_terms(c))))
    };
    let (places, labels): (Vec<_>, Vec<_>) = chosen.and_then(label).into_iter().unzip();
    let points = Points2D::new(places).with_radii([pixels(1.5)]).with_colors([style::CHOSEN]);
    context.log("map/plan/candidates/costs", &points.with_labels(labels).with_draw_order(order::LABELS))
}

/// The cost and the terms that are more than nothing, dearest first.
fn cost_by_terms(candidate: &Candidate) -> String {
    /// Terms smaller than this are not told.
    const NOTHING: f64 = 0.05;
    let mut terms: Vec<(&str, f64)> = candidate.terms.named().into_iter().filter(|(_, v)| *v >= NOTHING).collect();
    terms.sort_by(|a, b| b.1.total_cmp(&a.1));
    let told: Vec<String> = terms.iter().map(|(name, value)| format!("{name} {value:.1}")).collect();
    let equals = if told.is_empty() { "" } else { " = " };
    format!("{:.1}{equals}{}", candidate.cost, told.join(" + "))
}

/// One label for each reason, on the middle one of the candidates that have it: a label on each would hide the road.
/// The labels stand at different stations, the candidates meet again at their ends.
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
