//! Tests of the reader on one small file and its variations.

use std::f64::consts::{FRAC_PI_2, TAU};

use proptest::prelude::*;

use super::{ReadError, read_str};
use crate::geometry::Point;
use crate::map::{GoalPosition, Motion, ObstacleKind, Part, Scenario};

/// Two lanelets one behind the other, one beside the first, a speed limit, a light, a stop line, one obstacle of every
/// kind, two goal states. Coordinates are around 10⁶ to notice lost digits.
const SMALL: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<commonRoad timeStepSize="0.1" commonRoadVersion="2020a" benchmarkID="ZAM_Small-1_1_T-1" author="" date="">
  <scenarioTags><urban/></scenarioTags>
  <lanelet id="1">
    <leftBound>
      <point><x>1000000.0</x><y>3.5</y></point>
      <point><x>1000050.0</x><y>3.5</y></point>
    </leftBound>
    <rightBound>
      <point><x>1000000.0</x><y>0.0</y></point>
      <point><x>1000050.0</x><y>0.0</y></point>
    </rightBound>
    <successor ref="2"/>
    <adjacentLeft ref="3" drivingDir="opposite"/>
    <stopLine><lineMarking>solid</lineMarking><trafficLightRef ref="20"/></stopLine>
    <laneletType>urban</laneletType>
    <trafficSignRef ref="10"/>
  </lanelet>
  <lanelet id="2">
    <leftBound>
      <point><x>1000050.0</x><y>3.5</y></point>
      <point><x>1000075.0</x><y>3.5</y></point>
      <point><x>1000100.0</x><y>3.5</y></point>
    </leftBound>
    <rightBound>
      <point><x>1000050.0</x><y>0.0</y></point>
      <point><x>1000100.0</x><y>0.0</y></point>
    </rightBound>
    <predecessor ref="1"/>
  </lanelet>
  <lanelet id="3">
    <leftBound>
      <point><x>1000050.0</x><y>3.5</y></point>
      <point><x>1000000.0</x><y>3.5</y></point>
    </leftBound>
    <rightBound>
      <point><x>1000050.0</x><y>7.0</y></point>
      <point><x>1000000.0</x><y>7.0</y></point>
    </rightBound>
    <adjacentLeft ref="1" drivingDir="opposite"/>
  </lanelet>
  <trafficSign id="10">
    <trafficSignElement><trafficSignID>274</trafficSignID><additionalValue>13.89</additionalValue></trafficSignElement>
    <trafficSignElement><trafficSignID>274.2</trafficSignID><additionalValue>8.0</additionalValue></trafficSignElement>
  </trafficSign>
  <trafficLight id="20">
    <cycle>
      <cycleElement><duration>30</duration><color>red</color></cycleElement>
      <cycleElement><duration>50</duration><color>green</color></cycleElement>
      <timeOffset>5</timeOffset>
    </cycle>
  </trafficLight>
  <staticObstacle id="30">
    <type>parkedVehicle</type>
    <shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>
    <initialState>
      <position><point><x>1000030.0</x><y>1.0</y></point></position>
      <orientation><exact>0.25</exact></orientation>
      <time><exact>0</exact></time>
    </initialState>
  </staticObstacle>
  <dynamicObstacle id="31">
    <type>car</type>
    <shape><rectangle><length>4.0</length><width>2.0</width></rectangle><circle><radius>0.5</radius><center><x>2.0</x><y>0.0</y></center></circle></shape>
    <initialState>
      <position><point><x>1000000.0</x><y>1.75</y></point></position>
      <orientation><exact>0.0</exact></orientation>
      <time><exact>2</exact></time>
      <velocity><exact>10.0</exact></velocity>
    </initialState>
    <trajectory>
      <state>
        <position><point><x>1000001.0</x><y>1.75</y></point></position>
        <orientation><exact>0.0</exact></orientation>
        <time><exact>3</exact></time>
        <velocity><exact>10.0</exact></velocity>
      </state>
      <state>
        <position><point><x>1000002.0</x><y>1.75</y></point></position>
        <orientation><exact>0.0</exact></orientation>
        <time><exact>4</exact></time>
        <velocity><exact>10.0</exact></velocity>
      </state>
    </trajectory>
  </dynamicObstacle>
  <dynamicObstacle id="32">
    <type>pedestrian</type>
    <shape><circle><radius>0.4</radius></circle></shape>
    <initialState>
      <position><point><x>1000040.0</x><y>5.0</y></point></position>
      <time><exact>0</exact></time>
    </initialState>
    <occupancySet>
      <occupancy>
        <shape><polygon><point><x>1000039.0</x><y>4.0</y></point><point><x>1000041.0</x><y>4.0</y></point><point><x>1000040.0</x><y>6.0</y></point></polygon></shape>
        <time><exact>1</exact></time>
      </occupancy>
      <occupancy>
        <shape><circle><radius>2.0</radius><center><x>1000040.0</x><y>4.0</y></center></circle></shape>
        <time><intervalStart>2</intervalStart><intervalEnd>4</intervalEnd></time>
      </occupancy>
    </occupancySet>
  </dynamicObstacle>
  <environmentObstacle id="33">
    <type>building</type>
    <shape><polygon><point><x>1000010.0</x><y>10.0</y></point><point><x>1000020.0</x><y>10.0</y></point><point><x>1000020.0</x><y>20.0</y></point><point><x>1000010.0</x><y>10.0</y></point></polygon></shape>
  </environmentObstacle>
  <phantomObstacle id="34">
    <occupancySet>
      <occupancy>
        <shape><rectangle><length>2.0</length><width>1.0</width><orientation>0.0</orientation><center><x>1000060.0</x><y>1.0</y></center></rectangle></shape>
        <time><intervalStart>0</intervalStart><intervalEnd>9</intervalEnd></time>
      </occupancy>
    </occupancySet>
  </phantomObstacle>
  <planningProblem id="40">
    <initialState>
      <position><point><x>1000005.0</x><y>1.75</y></point></position>
      <orientation><exact>0.01</exact></orientation>
      <time><exact>0</exact></time>
      <velocity><exact>8.0</exact></velocity>
      <yawRate><exact>0.02</exact></yawRate>
      <slipAngle><exact>0.0</exact></slipAngle>
    </initialState>
    <goalState>
      <position><lanelet ref="2"/></position>
      <time><intervalStart>20</intervalStart><intervalEnd>80</intervalEnd></time>
      <velocity><intervalStart>0.0</intervalStart><intervalEnd>5.0</intervalEnd></velocity>
    </goalState>
    <goalState>
      <position><rectangle><length>10.0</length><width>3.0</width><orientation>0.1</orientation><center><x>1000095.0</x><y>1.75</y></center></rectangle></position>
      <orientation><intervalStart>3.0</intervalStart><intervalEnd>-3.0</intervalEnd></orientation>
      <time><exact>60</exact></time>
    </goalState>
  </planningProblem>
</commonRoad>
"#;

fn read(text: &str) -> Result<Scenario, ReadError> {
    read_str("small.xml", text)
}

/// The small file with one text replaced, which must occur.
fn with(from: &str, to: &str) -> String {
    assert!(SMALL.contains(from), "the small file has no {from}");
    SMALL.replacen(from, to, 1)
}

fn line_of(text: &str) -> usize {
    1 + SMALL[..SMALL.find(text).unwrap()].matches('\n').count()
}

/// The message of the error that reading must give; every message has to hold the given words.
fn refused(text: &str, words: &[&str]) -> ReadError {
    let error = read(text).expect_err("must be refused");
    let message = error.to_string();
    for word in words {
        assert!(message.contains(word), "\"{message}\" does not say \"{word}\"");
    }
    error
}

/// Issues that reading must give besides the scenario.
fn noted(text: &str, words: &[&str]) -> Scenario {
    let scenario = read(text).expect("must be read");
    let all: Vec<String> = scenario.issues.iter().map(ToString::to_string).collect();
    for word in words {
        assert!(all.iter().any(|i| i.contains(word)), "no issue says \"{word}\": {all:?}");
    }
    scenario
}

#[test]
fn the_small_file_is_read_whole_and_without_issues() {
    let s = read(SMALL).unwrap();
    assert_eq!(s.issues, []);
    assert_eq!((s.id.as_str(), s.version.as_str(), s.time_step), ("ZAM_Small-1_1_T-1", "2020a", 0.1));
    assert_eq!(s.network.lanelets.len(), 3);
    assert_eq!(s.obstacles.iter().map(|o| o.id).collect::<Vec<_>>(), [30, 31, 32, 33, 34]);
    assert_eq!(s.problems.len(), 1);
}

#[test]
fn lanelets_keep_their_neighbourhood_rules_and_middle() {
    let s = read(SMALL).unwrap();
    let one = &s.network.lanelets[&1];
    assert_eq!((one.successors.as_slice(), one.predecessors.as_slice()), ([2].as_slice(), [].as_slice()));
    let left = one.adjacent_left.unwrap();
    assert_eq!((left.id, left.same_direction), (3, false));
    assert_eq!(one.speed_limit, Some(13.89), "the end of a zone (274.2) is no limit");
    assert_eq!((one.signs.as_slice(), one.lights.as_slice()), ([10].as_slice(), [20].as_slice()));
    assert_eq!(one.types, ["urban"]);
    let stop = one.stop_line.unwrap();
    assert_eq!((stop.start, stop.end), (Point::new(1_000_050.0, 3.5), Point::new(1_000_050.0, 0.0)));
    let two = &s.network.lanelets[&2];
    assert_eq!(two.centre.points().len(), 3, "bounds of 3 and 2 points");
    assert!(two.centre.points().iter().all(|p| (p.y - 1.75).abs() < 1e-12));
    assert_eq!(two.centre.points()[1], Point::new(1_000_075.0, 1.75));
    assert_eq!(two.speed_limit, None);
    let light = &s.network.lights[&20];
    assert_eq!(
        (light.cycle.as_slice(), light.offset),
        ([("red".to_owned(), 30), ("green".to_owned(), 50)].as_slice(), 5)
    );
}

#[test]
fn obstacles_keep_shape_kind_and_motion_in_seconds() {
    let s = read(SMALL).unwrap();
    let [parked, car, walker, building, phantom] = s.obstacles.as_slice() else { panic!() };
    assert_eq!(parked.kind, ObstacleKind::ParkedVehicle);
    let Motion::Static(pose) = &parked.motion else { panic!() };
    assert_eq!((pose.position, pose.yaw), (Point::new(1_000_030.0, 1.0), 0.25));

    assert_eq!((car.kind, car.shape.parts.len()), (ObstacleKind::Vehicle, 2));
    let Motion::Trajectory(states) = &car.motion else { panic!() };
    assert_eq!(states.len(), 3, "the initial state comes first");
    assert!((states[0].time - 0.2).abs() < 1e-15 && (states[2].time - 0.4).abs() < 1e-15);
    assert_eq!(car.pose_at(0.1), None, "it does not exist before its first step");

    assert_eq!(walker.kind, ObstacleKind::Pedestrian);
    let Motion::Occupancy(sets) = &walker.motion else { panic!() };
    let times: Vec<(f64, f64)> = sets.iter().map(|o| (o.from, o.to)).collect();
    assert_eq!(times, [(0.0, 0.1), (0.0, 0.2), (0.1, 0.4)], "between two steps it is in either set");
    let Part::Circle { centre, radius } = &sets[0].region.parts[0] else { panic!() };
    assert_eq!((*centre, *radius), (Point::new(1_000_040.0, 5.0), 0.4), "the initial state is a set too");

    assert_eq!(building.kind, ObstacleKind::Structure);
    let Motion::Static(pose) = &building.motion else { panic!() };
    let world = building.shape.moved(pose);
    let Part::Polygon { vertices } = &world.parts[0] else { panic!() };
    assert_eq!(vertices.len(), 3, "the repeated vertex is gone");
    assert!((vertices[2] - Point::new(1_000_020.0, 20.0)).norm() < 1e-9);
    assert!(building.shape.bounding_radius() < 8.0, "its frame lies at its middle, not a thousand kilometres away");

    assert_eq!(phantom.lifetime(), (0.0, 0.9));
}

#[test]
fn the_problem_keeps_start_and_every_goal() {
    let s = read(SMALL).unwrap();
    let p = &s.problems[0];
    assert_eq!(p.initial.centre.position, Point::new(1_000_005.0, 1.75));
    assert_eq!((p.initial.centre.yaw, p.initial.speed, p.initial.yaw_rate), (0.01, 8.0, 0.02));
    assert_eq!((p.initial.acceleration, p.initial.time_step), (0.0, 0));
    let [by_lanelet, by_shape] = p.goals.as_slice() else { panic!() };
    assert!(matches!(&by_lanelet.position, Some(GoalPosition::Lanelets(ids)) if ids == &[2]));
    assert!((by_lanelet.time.min - 2.0).abs() < 1e-12 && (by_lanelet.time.max - 8.0).abs() < 1e-12);
    assert_eq!(by_lanelet.speed.unwrap().max, 5.0);
    assert!(by_lanelet.yaw.is_none());
    let Some(GoalPosition::Shapes(shape)) = &by_shape.position else { panic!() };
    assert!(shape.contains(Point::new(1_000_099.0, 2.0)) && !shape.contains(Point::new(1_000_089.0, 2.0)));
    assert!((by_shape.time.min - 6.0).abs() < 1e-12 && by_shape.time.min == by_shape.time.max);
    let yaw = by_shape.yaw.unwrap();
    assert!(yaw.contains_angle(std::f64::consts::PI), "the interval 3 … −3 goes through π");
    assert!(!yaw.contains_angle(0.0));
    assert!((yaw.max - (TAU - 3.0)).abs() < 1e-12);
}

#[test]
fn a_2018b_file_has_limits_on_lanelets_and_obstacles_by_role() {
    let old = SMALL
        .replace("2020a", "2018b")
        .replace("<trafficSignRef ref=\"10\"/>", "<speedLimit>12.5</speedLimit>")
        .replace("<staticObstacle id=\"30\">", "<obstacle id=\"30\"><role>static</role>")
        .replace("</staticObstacle>", "</obstacle>")
        .replace("<dynamicObstacle id=\"31\">", "<obstacle id=\"31\"><role>dynamic</role>")
        .replacen("</dynamicObstacle>", "</obstacle>", 1);
    let s = read(&old).unwrap();
    assert_eq!(s.network.lanelets[&1].speed_limit, Some(12.5));
    assert!(matches!(s.obstacles[0].motion, Motion::Static(_)));
    assert!(matches!(s.obstacles[1].motion, Motion::Trajectory(_)));
    refused(&old.replace("<role>static", "<role>ghost"), &["ghost", "static or dynamic", "obstacle 30"]);
}

#[test]
fn the_lowest_limit_holds_and_national_numbers_are_known() {
    for code in ["MAX_SPEED", "274.1", "R2-1", "B14", "C43", "Ρ-32"] {
        let s = read(&with("<trafficSignID>274</trafficSignID>", &format!("<trafficSignID>{code}</trafficSignID>")))
            .unwrap();
        assert_eq!(s.network.lanelets[&1].speed_limit, Some(13.89), "{code}");
    }
    let two = with("</laneletType>", "</laneletType><speedLimit>11.0</speedLimit>");
    assert_eq!(read(&two).unwrap().network.lanelets[&1].speed_limit, Some(11.0));
    let none = noted(&with("<additionalValue>13.89</additionalValue>", ""), &["speed limit without"]);
    assert_eq!(none.network.lanelets[&1].speed_limit, None);
}

#[test]
fn stop_lines_run_from_left_to_right_whichever_way_they_are_written() {
    let line = |a: &str, b: &str| {
        format!("<stopLine><point><x>1000045</x><y>{a}</y></point><point><x>1000045</x><y>{b}</y></point>")
    };
    for text in [line("3", "1"), line("1", "3")] {
        let stop = read(&with("<stopLine>", &text)).unwrap().network.lanelets[&1].stop_line.unwrap();
        assert_eq!((stop.start.y, stop.end.y), (3.0, 1.0));
    }
    let one = with("<stopLine>", "<stopLine><point><x>1000045</x><y>1</y></point>");
    let s = noted(&one, &["lanelet 1, stopLine"]);
    assert_eq!(s.network.lanelets[&1].stop_line.unwrap().start.x, 1_000_050.0);
}

#[test]
fn what_is_no_scenario_is_refused_with_its_reason() {
    refused("", &["small.xml:", "not XML"]);
    refused("hello", &["small.xml:1", "not XML"]);
    refused("<osm version=\"0.6\"/>", &["<osm>", "<commonRoad>"]);
    refused(&with("2020a", "2017a"), &["2017a", "2018b or 2020a", "small.xml:2"]);
    refused(&with("commonRoadVersion=\"2020a\"", ""), &["commonRoadVersion"]);
    refused(&SMALL[..SMALL.len() / 2], &["not XML"]);
    let start = SMALL.find("<planningProblem").unwrap();
    let end = SMALL.find("</planningProblem>").unwrap() + "</planningProblem>".len();
    let without = format!("{}{}", &SMALL[..start], &SMALL[end..]);
    assert!(matches!(refused(&without, &["planningProblem"]), ReadError::NoPlanningProblem { .. }));
}

#[test]
fn a_time_step_that_is_none_is_refused() {
    for dt in ["0", "-0.1", "NaN", "inf", "1e-9", "100", "", "fast"] {
        refused(&with("timeStepSize=\"0.1\"", &format!("timeStepSize=\"{dt}\"")), &["timeStepSize", "small.xml:2"]);
    }
    refused(&with("timeStepSize=\"0.1\"", ""), &["timeStepSize"]);
}

#[test]
fn broken_numbers_are_refused_wherever_they_stand() {
    let places = [
        ("<x>1000000.0</x>", "x", "lanelet 1, leftBound, point, x"),
        ("<additionalValue>13.89</additionalValue>", "additionalValue", "trafficSign 10"),
        ("<duration>30</duration>", "duration", "trafficLight 20"),
        ("<length>4.5</length>", "length", "staticObstacle 30, shape, rectangle"),
        ("<exact>0.25</exact>", "exact", "staticObstacle 30, initialState, orientation"),
        ("<exact>10.0</exact>", "exact", "dynamicObstacle 31, initialState, velocity"),
        ("<radius>0.4</radius>", "radius", "dynamicObstacle 32"),
        ("<exact>8.0</exact>", "exact", "planningProblem 40, initialState, velocity"),
        ("<intervalEnd>80</intervalEnd>", "intervalEnd", "planningProblem 40, goalState, time"),
    ];
    for (text, tag, place) in places {
        for bad in ["NaN", "inf", "-inf", "1e400", "1e30", "", "two", "1,5"] {
            let error = refused(&with(text, &format!("<{tag}>{bad}</{tag}>")), &[place]);
            let ReadError::BadValue { place, .. } = error else { panic!("{error}") };
            assert_eq!(place.line as usize, line_of(text), "{text} as {bad}");
        }
    }
}

#[test]
fn sizes_have_to_be_above_zero() {
    for (tag, value) in [("length", "4.5"), ("width", "1.8"), ("radius", "0.5")] {
        for bad in ["0", "-1"] {
            refused(&with(&format!("<{tag}>{value}"), &format!("<{tag}>{bad}")), &["above 0"]);
        }
    }
}

#[test]
fn a_lanelet_of_one_point_is_refused() {
    let one = with("<point><x>1000050.0</x><y>0.0</y></point>", "");
    let ReadError::BadPoints { place, found, .. } = refused(&one, &["lanelet 1, rightBound"]) else { panic!() };
    assert_eq!((place.line, found), (9, 1));
    refused(&with("<x>1000050.0</x><y>0.0</y>", "<x>1000000.0</x><y>0.0</y>"), &["lanelet 1, rightBound"]);
    refused(
        &with("<leftBound>", "<leftBounds>").replacen("</leftBound>", "</leftBounds>", 1),
        &["lanelet 1", "leftBound"],
    );
}

#[test]
fn an_obstacle_without_shape_or_state_is_refused() {
    let shape = "<shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>";
    refused(&with(shape, ""), &["staticObstacle 30", "shape"]);
    refused(&with(shape, "<shape/>"), &["staticObstacle 30, shape", "rectangle, circle or polygon"]);
    refused(&with(shape, "<shape><blob/></shape>"), &["blob"]);
    refused(
        &with("<position><point><x>1000030.0</x><y>1.0</y></point></position>", ""),
        &["staticObstacle 30", "position"],
    );
    refused(&with("<point><x>1000041.0</x><y>4.0</y></point>", ""), &["polygon", "2 point(s)"]);
    refused(&with("<x>1000040.0</x><y>6.0</y>", "<x>1000045.0</x><y>4.0</y>"), &["polygon", "around an area"]);
}

#[test]
fn a_lanelet_longer_than_any_road_is_refused() {
    refused(&with("<x>1000100.0</x><y>0.0</y>", "<x>9000000.0</x><y>0.0</y>"), &["rightBound", "7999950 m", "100 km"]);
}

#[test]
fn a_problem_without_its_parts_is_refused() {
    refused(&with("<exact>8.0</exact>", ""), &["planningProblem 40", "exact, or intervalStart"]);
    refused(&with("<orientation><exact>0.01</exact></orientation>", ""), &["planningProblem 40", "orientation"]);
    refused(&with("<velocity><exact>8.0</exact></velocity>", ""), &["planningProblem 40", "velocity"]);
    refused(&with("<exact>8.0</exact>", "<exact>-1e9</exact>"), &["planningProblem 40", "-1000000000", "150 m/s"]);
    refused(&with("<time><exact>60</exact></time>", ""), &["goalState", "time"]);
    refused(
        &with("<intervalEnd>80</intervalEnd>", "<intervalEnd>8</intervalEnd>"),
        &["20", "8", "end before it starts"],
    );
    refused(&with("<lanelet ref=\"2\"/>", "<lanelet ref=\"77\"/>"), &["goalState, position", "none of the lanelets"]);
    refused(
        &with("<lanelet ref=\"2\"/>", "<point><x>1</x><y>2</y></point>"),
        &["point", "rectangle, circle or polygon"],
    );
    refused(&with("<planningProblem id=\"40\">", "<planningProblem>"), &["planningProblem", "id"]);
}

#[test]
fn two_elements_of_one_id_are_refused_unless_both_can_be_kept() {
    refused(&with("<lanelet id=\"3\">", "<lanelet id=\"1\">"), &["lanelet 1", "already taken"]);
    let s = noted(&with("<environmentObstacle id=\"33\">", "<environmentObstacle id=\"30\">"), &["already taken"]);
    assert_eq!(s.obstacles.len(), 5);
}

#[test]
fn dangling_references_are_left_out_and_noted() {
    let s = noted(
        &with("<successor ref=\"2\"/>", "<successor ref=\"99\"/><successor ref=\"2\"/><successor ref=\"2\"/>"),
        &["lanelet 1: names successor 99"],
    );
    assert_eq!(s.network.lanelets[&1].successors, [2]);
    assert_eq!(s.issues[0].line, 4);
    let s = noted(&with("<adjacentLeft ref=\"3\"", "<adjacentLeft ref=\"99\""), &["left neighbour 99"]);
    assert_eq!(s.network.lanelets[&1].adjacent_left, None);
    let s = noted(&with("<trafficSignRef ref=\"10\"/>", "<trafficSignRef ref=\"99\"/>"), &["traffic sign 99"]);
    assert_eq!(s.network.lanelets[&1].speed_limit, None);
    noted(&with("<trafficLightRef ref=\"20\"/>", "<trafficLightRef ref=\"99\"/>"), &["traffic light 99"]);
    let s = noted(&with("<lanelet ref=\"2\"/>", "<lanelet ref=\"2\"/><lanelet ref=\"77\"/>"), &["lanelet 77"]);
    assert!(matches!(&s.problems[0].goals[0].position, Some(GoalPosition::Lanelets(ids)) if ids == &[2]));
    refused(&with("<successor ref=\"2\"/>", "<successor ref=\"two\"/>"), &["two", "integer id"]);
}

#[test]
fn unknown_things_are_noted_and_skipped() {
    noted(&with("<scenarioTags>", "<weather/><scenarioTags>"), &["line 3: weather: unknown element"]);
    noted(&with("<type>car</type>", "<type>hovercraft</type><engine/>"), &["hovercraft", "dynamicObstacle 31, engine"]);
    noted(&with("drivingDir=\"opposite\"", "drivingDir=\"up\""), &["taken as opposite"]);
}

#[test]
fn uncertain_states_are_reduced_to_their_middle_and_noted() {
    let s = noted(
        &with(
            "<point><x>1000001.0</x><y>1.75</y></point>",
            "<rectangle><length>1</length><width>1</width><center><x>1000001.5</x><y>2</y></center></rectangle>",
        ),
        &["1 of 2 states are uncertain"],
    );
    let Motion::Trajectory(states) = &s.obstacles[1].motion else { panic!() };
    assert_eq!(states[1].pose.position, Point::new(1_000_001.5, 2.0));
    let s = noted(
        &with("<exact>8.0</exact>", "<intervalStart>7.0</intervalStart><intervalEnd>8.0</intervalEnd>"),
        &["planningProblem 40, initialState: is uncertain"],
    );
    assert_eq!(s.problems[0].initial.speed, 7.5);
    noted(&with("<exact>8.0</exact>", "<exact>-2.0</exact>"), &["rolls backwards at 2 m/s"]);
}

#[test]
fn an_obstacle_that_nobody_predicts_stands_where_it_is() {
    let start = SMALL.find("<trajectory>").unwrap();
    let end = SMALL.find("</trajectory>").unwrap() + "</trajectory>".len();
    let s = noted(&format!("{}{}", &SMALL[..start], &SMALL[end..]), &["dynamicObstacle 31: has no prediction"]);
    assert!(s.obstacles[1].is_static());
}

#[test]
fn states_out_of_order_are_sorted_and_missing_headings_follow_the_motion() {
    let swapped = SMALL.replace("<exact>3</exact>", "<exact>9</exact>");
    let s = noted(&swapped, &["not in order of time"]);
    let Motion::Trajectory(states) = &s.obstacles[1].motion else { panic!() };
    assert!(states.is_sorted_by(|a, b| a.time < b.time));
    noted(&swapped, &["has 1 gap(s) between its states, the longest of 5 time steps"]);

    let state = "<x>1000001.0</x><y>1.75</y></point></position>\n        <orientation><exact>0.0</exact></orientation>";
    let headless = with(state, "<x>1000002.0</x><y>0.75</y></point></position>");
    let s = noted(&headless, &["1 states have no orientation"]);
    let Motion::Trajectory(states) = &s.obstacles[1].motion else { panic!() };
    assert!((states[1].pose.yaw - FRAC_PI_2).abs() < 1e-9, "it moves straight up to the next state");

    let s = noted(&with("<exact>3</exact>", "<exact>2</exact>"), &["elsewhere than another one of the same time"]);
    let Motion::Trajectory(states) = &s.obstacles[1].motion else { panic!() };
    assert_eq!(states[0].pose.position.x, 1_000_000.0, "the initial state wins");
}

#[test]
fn speeds_that_contradict_the_positions_are_replaced() {
    let s = noted(&SMALL.replace("<velocity><exact>10.0", "<velocity><exact>17.0"), &["3 speeds contradict"]);
    let Motion::Trajectory(states) = &s.obstacles[1].motion else { panic!() };
    assert!(states.iter().all(|s| (s.speed - 10.0).abs() < 1e-6), "{states:?}");
    let one = read(&with("<velocity><exact>10.0", "<velocity><exact>17.0")).unwrap();
    assert_eq!(one.issues, [], "a single one is kept");
}

#[test]
fn sets_of_single_steps_leave_no_gap_and_intervals_that_touch_are_kept() {
    let widened = super::obstacle::without_gaps(&[(0.0, 0.0), (1.0, 1.0), (1.0, 1.0), (4.0, 6.0), (6.0, 7.0)]);
    assert_eq!(widened, [(0.0, 1.0), (0.0, 4.0), (0.0, 4.0), (1.0, 6.0), (6.0, 7.0)]);
}

#[test]
fn bombs_and_towers_are_refused_or_read_in_time() {
    let bomb = "<!DOCTYPE x [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;\">]><commonRoad>&b;</commonRoad>";
    refused(bomb, &["not XML"]);
    let tower = format!("{}{}", "<a>".repeat(200_000), "</a>".repeat(200_000));
    refused(&tower, &["<a>"]);
    let inside = with("<scenarioTags>", &format!("{tower}<scenarioTags>"));
    assert_eq!(read(&inside).unwrap().issues.len(), 1);
    let wide = with("<successor ref=\"2\"/>", &"<successor ref=\"9\"/>".repeat(100_000));
    assert_eq!(read(&wide).unwrap().issues.len(), 1);
    let hard = with("<scenarioTags>", &"<w/>\n".repeat(100_000));
    assert!(read(&hard).is_err(), "the tags are closed twice");
    let polygon = "<point><x>1</x><y>2</y></point><point><x>2</x><y>3</y></point>".repeat(2000);
    refused(&with("<point><x>1000039.0</x><y>4.0</y></point>", &polygon), &["polygon", "at most 1000"]);
}

#[test]
fn a_byte_order_mark_and_comments_do_no_harm() {
    let s = read(&format!("\u{feff}{SMALL}")).unwrap();
    assert_eq!(s.issues, []);
    let s = read(&with("<exact>8.0</exact>", "<exact><!-- m/s --> 8<!-- and -->.5 </exact>")).unwrap();
    assert_eq!(s.problems[0].initial.speed, 8.5);
}

#[test]
fn a_utf16_or_compressed_scenario_is_read() {
    let utf16: Vec<u8> = SMALL.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    std::io::Write::write_all(&mut gzip, &utf16).unwrap();
    for bytes in [utf16, gzip.finish().unwrap()] {
        let s = super::read_from("-", bytes.as_slice()).unwrap();
        assert_eq!((s.obstacles.len(), s.issues), (5, vec![]));
    }
}

#[test]
fn files_that_cannot_be_read_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("none.xml");
    let error = super::read_file(&path).unwrap_err();
    assert!(matches!(error, ReadError::Input(_)) && error.to_string().contains("none.xml"), "{error}");
    assert!(matches!(super::read_file(folder.path()), Err(ReadError::Input(_))), "a folder");
    std::fs::write(&path, b"<commonRoad>\n\xff\xfe</commonRoad>").unwrap();
    let error = super::read_file(&path).unwrap_err();
    assert!(error.to_string().contains("none.xml:2: not text: byte 0xff"), "{error}");
    std::fs::write(&path, SMALL).unwrap();
    assert_eq!(super::read_file(&path).unwrap().obstacles.len(), 5);
}

/// One careless edit of a text: bytes cut out, doubled, or replaced; elements cut out or doubled.
#[derive(Debug, Clone)]
enum Edit {
    Cut(usize, usize),
    Double(usize, usize),
    Replace(usize, char),
    CutElement(usize),
    DoubleElement(usize),
    Number(usize, f64),
}

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    let edit = prop_oneof![
        (any::<usize>(), 1..40usize).prop_map(|(at, n)| Edit::Cut(at, n)),
        (any::<usize>(), 1..40usize).prop_map(|(at, n)| Edit::Double(at, n)),
        (any::<usize>(), any::<char>()).prop_map(|(at, c)| Edit::Replace(at, c)),
        any::<usize>().prop_map(Edit::CutElement),
        any::<usize>().prop_map(Edit::DoubleElement),
        (any::<usize>(), any::<f64>()).prop_map(|(at, x)| Edit::Number(at, x)),
    ];
    prop::collection::vec(edit, 1..4)
}

fn apply(text: &str, edit: &Edit) -> String {
    let chars: Vec<char> = text.chars().collect();
    if chars.is_empty() {
        return String::new();
    }
    let splice =
        |from: usize, to: usize, new: &[char]| [&chars[..from], new, &chars[to..]].concat().into_iter().collect();
    let element = |at: usize| {
        let document = roxmltree::Document::parse(text).ok()?;
        let elements: Vec<_> =
            document.descendants().filter(|n| n.is_element() && n.parent_element().is_some()).collect();
        (!elements.is_empty()).then(|| elements[at % elements.len()].range())
    };
    match edit {
        Edit::Cut(at, n) => splice(at % chars.len(), (at % chars.len() + n).min(chars.len()), &[]),
        Edit::Double(at, n) => {
            let from = at % chars.len();
            let part = chars[from..(from + n).min(chars.len())].to_vec();
            splice(from, from, &part)
        }
        Edit::Replace(at, c) => splice(at % chars.len(), at % chars.len() + 1, &[*c]),
        Edit::CutElement(at) => {
            element(*at).map_or_else(String::new, |r| format!("{}{}", &text[..r.start], &text[r.end..]))
        }
        Edit::DoubleElement(at) => element(*at)
            .map_or_else(String::new, |r| format!("{}{}{}", &text[..r.end], &text[r.clone()], &text[r.end..])),
        Edit::Number(at, x) => {
            let numbers: Vec<usize> = text.match_indices(|c: char| c.is_ascii_digit()).map(|(i, _)| i).collect();
            let at = numbers[at % numbers.len().max(1)];
            format!("{}{x}{}", &text[..at], &text[at + 1..])
        }
    }
}

/// What holds of every scenario that the reader lets through.
fn is_sound(s: &Scenario) {
    assert!(s.time_step > 0.0 && s.time_step.is_finite());
    assert!(!s.problems.is_empty());
    for l in s.network.lanelets.values() {
        assert!(l.centre.length() > 0.0 && l.centre.length().is_finite());
        assert!(l.successors.iter().chain(&l.predecessors).all(|id| s.network.lanelets.contains_key(id)));
        assert!(l.speed_limit.is_none_or(|v| v > 0.0 && v.is_finite()));
    }
    for o in &s.obstacles {
        assert!(o.shape.bounding_radius() > 0.0 && o.shape.bounding_radius().is_finite());
        let (from, to) = o.lifetime();
        assert!(from <= to, "obstacle {} lives from {from} to {to}", o.id);
        for t in [from, f64::midpoint(from, to), to, 0.25] {
            if (from..=to).contains(&t) {
                assert!(!o.occupied_at(t).is_empty(), "obstacle {} is nowhere at {t}", o.id);
            }
        }
        if let Motion::Trajectory(states) = &o.motion {
            assert!(states.is_sorted_by(|a, b| a.time < b.time));
            assert!(
                states.iter().all(|t| t.speed.is_finite() && t.pose.position.x.is_finite() && t.pose.yaw.is_finite())
            );
        }
    }
    for goal in s.problems.iter().flat_map(|p| &p.goals) {
        assert!(goal.time.min <= goal.time.max);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]
    #[test]
    fn careless_edits_never_panic_and_never_pass_something_unsound(edits in edits()) {
        let text = edits.iter().fold(SMALL.to_owned(), |text, edit| if text.is_empty() { text } else { apply(&text, edit) });
        match read(&text) {
            Ok(scenario) => is_sound(&scenario),
            Err(error) => prop_assert!(error.to_string().starts_with("small.xml")),
        }
    }
}
