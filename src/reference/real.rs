//! Reference lines of published road networks. The tests print a note and pass if the files do not exist.

use super::tests::{WIDTH, line, real_data, real_scenarios};
use super::*;

/// Chains of about 200 m from every drivable lanelet: each of its successors, then always the first successor.
fn chains(network: &RoadNetwork) -> Vec<Vec<LaneletId>> {
    let known = |id: &LaneletId| network.lanelets.contains_key(id);
    let mut chains = Vec::new();
    for first in network.lanelets.values().filter(|l| l.is_drivable()) {
        let next: Vec<LaneletId> = first.successors.iter().copied().filter(known).collect();
        let starts = if next.is_empty() {
            vec![vec![first.id]]
        } else {
            next.into_iter().filter(|n| *n != first.id).map(|n| vec![first.id, n]).collect()
        };
        for mut chain in starts {
            let mut length: f64 = chain.iter().map(|id| network.lanelets[id].centre.length()).sum();
            while length < 200.0 {
                let Some(next) = network.lanelets[&chain[chain.len() - 1]].successors.iter().find(|n| known(n)) else {
                    break;
                };
                if chain.contains(next) {
                    break;
                }
                length += network.lanelets[next].centre.length();
                chain.push(*next);
            }
            chains.push(chain);
        }
    }
    chains
}

/// Largest gap between the end of a lanelet and the start of its successor on a chain, m.
fn largest_gap(network: &RoadNetwork, chain: &[LaneletId]) -> f64 {
    let centre = |id: &LaneletId| &network.lanelets[id].centre;
    chain.windows(2).map(|w| (centre(&w[1]).first() - centre(&w[0]).last()).norm()).fold(0.0, f64::max)
}

/// The smallest distance of the smoothed line to a lane bound (m, negative outside), with its station, over the knots where
/// the centre line itself is inside its lane. Bounds that jump or cross where lanelets meet leave the centre line outside.
fn nearest_to_bound(network: &RoadNetwork, chain: &[LaneletId], line: &ReferenceLine) -> (f64, f64) {
    let lanelets: Vec<&Lanelet> = chain.iter().map(|id| &network.lanelets[id]).collect();
    let joined = |side: fn(&Lanelet) -> &Polyline| joined(&lanelets, line.origin, side);
    let (left, right) = (joined(|l| &l.left), joined(|l| &l.right));
    let bounds = Bounds { left: left.as_ref(), right: right.as_ref() };
    let centre = joined(|l| &l.centre).unwrap();
    let steps = line.knots.len() - 1;
    let points: Vec<Point> = (0..=steps).map(|i| centre.at(centre.length() * i as f64 / steps as f64)).collect();
    let inside = |(left, right): &(f64, f64)| left.min(*right) > ReferenceSettings::default().min_freedom + 0.05;
    let widths = bounds.distances(&points);
    // a jump of a bound shows in the widths of the neighbours
    let clear = |i: usize| widths[i.saturating_sub(3)..(i + 4).min(widths.len())].iter().all(inside);
    let checked = line.knots.iter().enumerate().filter(|(i, _)| clear(*i));
    let checked = checked.map(|(_, knot)| (knot.left.min(knot.right), knot.station));
    checked.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, 0.0))
}

/// Every chain has a smoothed line inside its lane, with finite curvature and coordinates that survive a round trip.
#[test]
fn published_lanes_have_usable_lines() {
    let Some(folder) = real_data("commonroad") else { return };
    let settings = ReferenceSettings::default();
    let (mut count, mut metres, mut seconds, mut round_trips) = (0, 0.0, 0.0, 0);
    let (mut sharpest, mut nearest) = (Vec::new(), Vec::new());
    for (name, scenario) in real_scenarios(&folder) {
        let network = &scenario.network;
        for chain in chains(network).iter().filter(|c| largest_gap(network, c) < 3.0) {
            let begun = std::time::Instant::now();
            let line = match ReferenceLine::new(network, chain, WIDTH, &settings) {
                Ok(line) => line,
                Err(failure) => {
                    let length: f64 = chain.iter().map(|id| network.lanelets[id].centre.length()).sum();
                    assert!(length < MIN_LENGTH, "{name} {chain:?}: {failure}");
                    continue;
                }
            };
            seconds += begun.elapsed().as_secs_f64();
            count += 1;
            metres += line.length();
            assert!(line.is_smoothed(), "{name} {chain:?}");
            let place = |s: f64| format!("{name} {chain:?} at {s:.1} of {:.1} m", line.length());
            let (bound, s) = nearest_to_bound(network, chain, &line);
            nearest.push((-bound, place(s)));
            let steps = (line.length() / 0.25) as i32;
            let curvature = |i: i32| line.at(f64::from(i) * 0.25).curvature.abs();
            let (max, at) = (0..=steps).map(|i| (curvature(i), i)).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
            assert!((0..=steps).all(|i| curvature(i).is_finite()), "{}", place(0.0));
            sharpest.push((max, place(f64::from(at) * 0.25)));
            round_trips += round_trip(&line, &place);
        }
    }
    println!(
        "{count} lines, {:.0} m and {:.3} ms on average; {round_trips} round trips",
        metres / f64::from(count),
        1e3 * seconds / f64::from(count)
    );
    for (what, found) in [("sharpest, 1/m", &mut sharpest), ("farthest outside its lane, m", &mut nearest)] {
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        println!("{what}:");
        found.iter().take(12).for_each(|(value, place)| println!("{value:.3} {place}"));
    }
    assert!(count > 1000 && round_trips > 10_000);
    assert!(nearest[0].0 < 0.0, "outside its lane: {:?}", nearest[0]);
}

/// Both round trips at some places within the unique offsets, at most 5 m to either side.
fn round_trip(line: &ReferenceLine, place: &dyn Fn(f64) -> String) -> usize {
    let steps = (line.length() / 7.3) as i32;
    for i in 0..=steps {
        let s = f64::from(i) * 7.3;
        let share = 0.9 * (f64::from(i) * 2.1 + 0.4).sin();
        let within = |(left, right): (f64, f64)| share * if share > 0.0 { left.min(5.0) } else { right.min(5.0) };
        let l = within(line.unique_offsets(s));
        let p = line.from_frenet(s, l);
        let back = line.project(p);
        assert!((back.s - s).abs() < 1e-6 && (back.l - l).abs() < 1e-6, "({s}, {l}) is {back:?}, {}", place(s));
        assert!((line.from_frenet(back.s, back.l) - p).norm() < 1e-6);
        let l = within(line.unique_offsets_within(s, 11.0));
        let back = line.project_near(line.from_frenet(s, l), s + share);
        assert!((back.s - s).abs() < 1e-6 && (back.l - l).abs() < 1e-6, "({s}, {l}) is near {back:?}, {}", place(s));
    }
    2 * (steps as usize + 1)
}

/// The corridors that the route planner returns: their lines contain the start and the goal.
#[test]
fn published_corridors_contain_their_start_and_goal() {
    let Some(folder) = real_data("commonroad") else { return };
    let mut sharpest: Vec<(f64, String)> = Vec::new();
    for (name, scenario) in real_scenarios(&folder) {
        for problem in &scenario.problems {
            let start = problem.initial.centre;
            let outcome = crate::route::plan(&scenario.network, &start, &problem.goals, &Default::default());
            for lane in &outcome.route().unwrap().lanes {
                let line = line(&scenario.network, &lane.lanelets);
                let foot = line.project(start.position);
                let tolerance = 1.0 + 0.02 * lane.start_station;
                assert!((foot.s - lane.start_station).abs() < tolerance, "{name}: {foot:?} but {}", lane.start_station);
                if let Some(goal) = lane.goal {
                    let (near, far) = (line.project(goal.near), line.project(goal.far));
                    assert!(near.s <= far.s + 1e-6 && near.l.abs() < 1.5, "{name}: {near:?} {far:?}");
                }
                let reach = line.length().min(foot.s + 150.0);
                let steps = ((reach - foot.s).max(0.0) / 0.25) as i32;
                let at = |i: i32| (line.at(foot.s + f64::from(i) * 0.25).curvature.abs(), i);
                let (curvature, i) = (0..=steps).map(at).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
                sharpest.push((curvature, format!("{name} {:?} {:.0} m ahead", lane.side, f64::from(i) * 0.25)));
            }
        }
    }
    sharpest.sort_by(|a, b| b.0.total_cmp(&a.0));
    println!("{} corridors, sharpest within 150 m:", sharpest.len());
    for (curvature, place) in sharpest.iter().take(30) {
        println!("{curvature:.3} {place}");
    }
}
