//! Tests of the reader on one small file and variations of it.

use std::f64::consts::{FRAC_PI_2, TAU};

use proptest::prelude::*;

use super::{ElementError, ReadError, read_str};
use crate::geometry::Point;
use crate::map::{GoalPosition, Motion, ObstacleKind, Part, Scenario};

/// Two successive lanelets, one beside the first, a speed limit, a light, a stop line, one obstacle of every kind, two
/// goal states. Coordinates are around 10⁶, so that a loss of digits shows.
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

/// The small file with the first occurrence of a text replaced.
fn with(from: &str, to: &str) -> String {
    assert!(SMALL.contains(from), "the small file has no {from}");
    SMALL.replacen(from, to, 1)
}

fn line_of(text: &str) -> usize {
    1 + SMALL[..SMALL.find(text).unwrap()].matches('\n').count()
}

/// The error of reading the text. Its message contains the words.
fn refused(text: &str, words: &[&str]) -> ReadError {
    let error = read(text).expect_err("must be refused");
    let message = error.to_string();
    for word in words {
        assert!(message.contains(word), "\"{message}\" does not say \"{word}\"");
    }
    error
}

/// The only error among the elements of the text. Its message contains the words.
fn refused_element(text: &str, words: &[&str]) -> ElementError {
    let ReadError::Elements(mut errors) = refused(text, words) else { panic!("not an error of an element") };
    assert_eq!((errors.total(), errors.first().len()), (1, 1), "{errors}");
    errors.pop().unwrap()
}

/// The scenario. One of its issues contains each of the words.
fn noted(text: &str, words: &[&str]) -> Scenario {
    let scenario = read(text).expect("must be read");
    let all: Vec<String> = scenario.issues.iter().map(ToString::to_string).collect();
    for word in words {
        assert!(all.iter().any(|i| i.contains(word)), "no issue says \"{word}\": {all:?}");
    }
    scenario
}

#[test]
fn reads_the_small_file_without_issues() {
    let s = read(SMALL).unwrap();
    assert_eq!(s.issues, []);
    assert_eq!((s.id.as_str(), s.version.as_str(), s.time_step), ("ZAM_Small-1_1_T-1", "2020a", 0.1));
    assert_eq!(s.network.lanelets.len(), 3);
    assert_eq!(s.obstacles.iter().map(|o| o.id).collect::<Vec<_>>(), [30, 31, 32, 33, 34]);
    assert_eq!(s.problems.len(), 1);
}

#[test]
fn reads_neighbours_rules_and_centre_lines_of_lanelets() {
    let s = read(SMALL).unwrap();
    let one = &s.network.lanelets[&1];
    assert_eq!((one.successors.as_slice(), one.predecessors.as_slice()), ([2].as_slice(), [].as_slice()));
    let left = one.adjacent_left.unwrap();
    assert_eq!((left.id, left.same_direction), (3, false));
    assert_eq!(one.speed_limit, Some(13.89), "the end of a zone (274.2) sets no limit");
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
fn reads_shape_kind_and_motion_of_obstacles() {
    let s = read(SMALL).unwrap();
    let [parked, car, pedestrian, building, phantom] = s.obstacles.as_slice() else { panic!() };
    assert_eq!(parked.kind, ObstacleKind::ParkedVehicle);
    let Motion::Static(pose) = &parked.motion else { panic!() };
    assert_eq!((pose.position, pose.yaw), (Point::new(1_000_030.0, 1.0), 0.25));

    assert_eq!((car.kind, car.shape.parts.len()), (ObstacleKind::Vehicle, 2));
    let Motion::Trajectory(states) = &car.motion else { panic!() };
    assert_eq!(states.len(), 3, "the initial state comes first");
    assert!((states[0].time - 0.2).abs() < 1e-15 && (states[2].time - 0.4).abs() < 1e-15);
    assert_eq!(car.pose_at(0.1), None, "it does not exist before its first step");

    assert_eq!(pedestrian.kind, ObstacleKind::Pedestrian);
    let Motion::Occupancy(sets) = &pedestrian.motion else { panic!() };
    let times: Vec<(f64, f64)> = sets.iter().map(|o| (o.from, o.to)).collect();
    assert_eq!(times, [(0.0, 0.1), (0.0, 0.2), (0.1, 0.4)], "between two steps it is in either set");
    let Part::Circle { centre, radius } = &sets[0].region.parts[0] else { panic!() };
    assert_eq!((*centre, *radius), (Point::new(1_000_040.0, 5.0), 0.4), "the initial state is the first set");

    assert_eq!(building.kind, ObstacleKind::Structure);
    let Motion::Static(pose) = &building.motion else { panic!() };
    let world = building.shape.moved(pose);
    let Part::Polygon { vertices } = &world.parts[0] else { panic!() };
    assert_eq!(vertices.len(), 3, "the repeated vertex is removed");
    assert!((vertices[2] - Point::new(1_000_020.0, 20.0)).norm() < 1e-9);
    assert!(building.shape.bounding_radius() < 8.0, "its frame is at its middle, not at the origin of the world");

    assert_eq!(phantom.lifetime(), (0.0, 0.9));
}

#[test]
fn reads_initial_state_and_goals_of_a_problem() {
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
fn reads_the_speed_limits_and_obstacle_roles_of_2018b() {
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
    refused_element(&old.replace("<role>static", "<role>ghost"), &["ghost", "static or dynamic", "obstacle 30"]);
}

#[test]
fn the_lowest_speed_limit_applies_and_national_sign_numbers_are_known() {
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
fn stop_lines_run_from_left_to_right_in_either_order_of_points() {
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
fn refuses_files_that_are_not_scenarios() {
    refused("", &["small.xml:", "not XML"]);
    refused("hello", &["small.xml:1", "not XML"]);
    refused("<osm version=\"0.6\"/>", &["small.xml: this is a Lanelet2", "<osm>", "<commonRoad>"]);
    refused("<note/>", &["small.xml:1: note: the root element is <note>, expected <commonRoad>"]);
    refused(&with("2020a", "2017a"), &["2017a", "2018b or 2020a", "small.xml:2"]);
    refused_element(&with("commonRoadVersion=\"2020a\"", ""), &["small.xml:2", "commonRoadVersion"]);
    refused(&SMALL[..SMALL.len() / 2], &["not XML"]);
    let cut = SMALL.trim_end().trim_end_matches("</commonRoad>").trim_end();
    refused(cut, &[&format!("small.xml:{}: not XML", cut.lines().count())]);
    let start = SMALL.find("<planningProblem").unwrap();
    let end = SMALL.find("</planningProblem>").unwrap() + "</planningProblem>".len();
    let without = format!("{}{}", &SMALL[..start], &SMALL[end..]);
    let error = refused_element(&without, &["small.xml:2: commonRoad: has no planningProblem"]);
    assert!(matches!(error, ElementError::NoPlanningProblem { .. }));
}

#[test]
fn names_the_kind_of_another_file() {
    let kind = |name: &str, bytes: &[u8]| super::read_bytes(name, bytes.to_vec()).unwrap_err().to_string();
    let image = kind("a.xml", b"\x89PNG\r\n\x1a\n\xff\xff");
    assert!(image.starts_with("a.xml: this is a PNG image, expected a CommonRoad scenario"), "{image}");
    let suite = kind("a.toml", b"[[drive]]\nscenarios = \"a.xml\"\n");
    assert!(suite.starts_with("a.toml: this is a regression suite, expected"), "{suite}");
    let utf16: Vec<u8> = "\u{feff}<OpenDRIVE/>".encode_utf16().flat_map(u16::to_be_bytes).collect();
    assert!(kind("a.xml", &utf16).contains("OpenDRIVE"), "{}", kind("a.xml", &utf16));
}

#[test]
fn refuses_invalid_time_steps() {
    for dt in ["0", "-0.1", "NaN", "inf", "1e-9", "100", "", "fast"] {
        let text = with("timeStepSize=\"0.1\"", &format!("timeStepSize=\"{dt}\""));
        refused_element(&text, &["timeStepSize", "small.xml:2"]);
    }
    refused_element(&with("timeStepSize=\"0.1\"", ""), &["timeStepSize"]);
}

#[test]
fn refuses_invalid_numbers_in_every_section() {
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
            let error = refused_element(&with(text, &format!("<{tag}>{bad}</{tag}>")), &[place]);
            let ElementError::BadValue { place, .. } = error else { panic!("{error}") };
            assert_eq!(place.line as usize, line_of(text), "{text} as {bad}");
        }
    }
}

#[test]
fn refuses_sizes_that_are_not_positive() {
    for (tag, value) in [("length", "4.5"), ("width", "1.8"), ("radius", "0.5")] {
        for bad in ["0", "-1"] {
            refused_element(&with(&format!("<{tag}>{value}"), &format!("<{tag}>{bad}")), &["above 0"]);
        }
    }
}

#[test]
fn refuses_a_lanelet_of_one_point() {
    let one = with("<point><x>1000050.0</x><y>0.0</y></point>", "");
    let ElementError::BadPoints { place, found, .. } = refused_element(&one, &["lanelet 1, rightBound"]) else {
        panic!()
    };
    assert_eq!((place.line, found), (9, 1));
    refused_element(&with("<x>1000050.0</x><y>0.0</y>", "<x>1000000.0</x><y>0.0</y>"), &["lanelet 1, rightBound"]);
    refused_element(
        &with("<leftBound>", "<leftBounds>").replacen("</leftBound>", "</leftBounds>", 1),
        &["lanelet 1", "leftBound"],
    );
}

#[test]
fn refuses_an_obstacle_without_shape_or_state() {
    let shape = "<shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>";
    refused_element(&with(shape, ""), &["staticObstacle 30", "shape"]);
    refused_element(&with(shape, "<shape/>"), &["staticObstacle 30, shape", "rectangle, circle or polygon"]);
    refused_element(&with(shape, "<shape><blob/></shape>"), &["blob"]);
    refused_element(
        &with("<position><point><x>1000030.0</x><y>1.0</y></point></position>", ""),
        &["staticObstacle 30", "position"],
    );
    refused_element(&with("<point><x>1000041.0</x><y>4.0</y></point>", ""), &["polygon", "2 point(s)"]);
    refused_element(&with("<x>1000040.0</x><y>6.0</y>", "<x>1000045.0</x><y>4.0</y>"), &["polygon", "around an area"]);
}

#[test]
fn refuses_a_lanelet_of_8000_km() {
    refused_element(
        &with("<x>1000100.0</x><y>0.0</y>", "<x>9000000.0</x><y>0.0</y>"),
        &["rightBound", "7999950 m", "100 km"],
    );
}

#[test]
fn refuses_an_incomplete_planning_problem() {
    refused_element(&with("<exact>8.0</exact>", ""), &["planningProblem 40", "exact, or intervalStart"]);
    refused_element(
        &with("<orientation><exact>0.01</exact></orientation>", ""),
        &["planningProblem 40", "orientation"],
    );
    refused_element(&with("<velocity><exact>8.0</exact></velocity>", ""), &["planningProblem 40", "velocity"]);
    refused_element(
        &with("<exact>8.0</exact>", "<exact>-1e9</exact>"),
        &["planningProblem 40", "-1000000000", "150 m/s"],
    );
    refused_element(
        &with("<exact>0.02</exact>", "<exact>-20.5</exact>"),
        &["planningProblem 40", "-20.5", "a yaw rate of at most 20 rad/s"],
    );
    for (slip, found) in [("2", "2"), ("-1.6", "-1.6")] {
        let text = with("<slipAngle><exact>0.0<", &format!("<slipAngle><exact>{slip}<"));
        refused_element(
            &text,
            &["planningProblem 40, initialState, slipAngle", found, "at most pi/2 rad to either side"],
        );
    }
    refused_element(&with("<time><exact>60</exact></time>", ""), &["goalState", "time"]);
    refused_element(
        &with("<intervalEnd>80</intervalEnd>", "<intervalEnd>8</intervalEnd>"),
        &["20", "8", "end before it starts"],
    );
    refused_element(
        &with("<lanelet ref=\"2\"/>", "<lanelet ref=\"77\"/>"),
        &["goalState, position", "refers to lanelet(s) 77"],
    );
    refused_element(
        &with("<lanelet ref=\"2\"/>", "<point><x>1</x><y>2</y></point>"),
        &["point", "rectangle, circle or polygon"],
    );
    refused_element(&with("<planningProblem id=\"40\">", "<planningProblem>"), &["planningProblem", "id"]);
}

#[test]
fn refuses_two_lanelets_but_not_two_obstacles_with_one_id() {
    refused_element(&with("<lanelet id=\"3\">", "<lanelet id=\"1\">"), &["small.xml:31: lanelet 1", "that of line 4"]);
    let s = noted(&with("<environmentObstacle id=\"33\">", "<environmentObstacle id=\"30\">"), &["has the same id"]);
    assert_eq!(s.obstacles.len(), 5);
}

#[test]
fn notes_an_id_that_a_lanelet_and_an_obstacle_share() {
    let s = noted(&with("<staticObstacle id=\"30\">", "<staticObstacle id=\"2\">"), &["line 19 has the same id"]);
    assert_eq!((s.issues.len(), s.issues[0].line as usize), (1, line_of("<staticObstacle id=\"30\">")));
    assert_eq!(
        s.issues[0].to_string(),
        "line 53: staticObstacle 2: the lanelet in line 19 has the same id; both are kept"
    );
    assert_eq!((s.network.lanelets.len(), s.obstacles.len()), (3, 5));
}

#[test]
fn leaves_out_dangling_references_with_an_issue() {
    let s = noted(
        &with("<successor ref=\"2\"/>", "<successor ref=\"99\"/><successor ref=\"2\"/><successor ref=\"2\"/>"),
        &["lanelet 1: refers to successor 99"],
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
fn skips_unknown_elements_with_an_issue() {
    noted(&with("<scenarioTags>", "<weather/><scenarioTags>"), &["line 3: weather: unknown element"]);
    noted(&with("<type>car</type>", "<type>hovercraft</type><engine/>"), &["hovercraft", "dynamicObstacle 31, engine"]);
    noted(&with("drivingDir=\"opposite\"", "drivingDir=\"up\""), &["assumed opposite"]);
}

/// A rectangle around a point, aligned with the axes.
fn region(x: f64, y: f64, length: f64) -> String {
    let centre = format!("<center><x>{x}</x><y>{y}</y></center>");
    format!("<rectangle><length>{length}</length><width>0.001</width>{centre}</rectangle>")
}

fn interval(from: f64, to: f64) -> String {
    format!("<intervalStart>{from}</intervalStart><intervalEnd>{to}</intervalEnd>")
}

#[test]
fn refuses_an_uncertain_state_with_its_line() {
    let problem = "planningProblem 40, initialState";
    let cases = [
        ("<point><x>1000005.0</x><y>1.75</y></point>", region(1_000_005.0, 1.75, 0.5), "position", "0.5000", "0.01 m"),
        ("<exact>0.01</exact>", interval(-0.1, 0.1), "orientation", "0.2", "0.001 rad"),
        ("<exact>8.0</exact>", interval(7.0, 8.0), "velocity", "1", "0.01 m/s"),
        ("<exact>0.02</exact>", interval(0.0, 0.02), "yawRate", "0.02", "0.001 rad/s"),
    ];
    for (exact, uncertain, element, width, tolerance) in cases {
        let (element, width) = (format!("{problem}, {element}"), format!("is uncertain by {width}"));
        let error = refused_element(&with(exact, &uncertain), &[&element, &width, tolerance]);
        assert!(matches!(error, ElementError::Uncertain { .. }), "{error:?}");
        assert_eq!(error.place().line as usize, line_of(exact), "{error}");
    }
    // the time and the acceleration of the planning problem
    let at = SMALL.find("<planningProblem").unwrap();
    let (before, after) = SMALL.split_at(at);
    let late = after.replacen("<time><exact>0</exact>", &format!("<time>{}", interval(0.0, 1.0)), 1);
    let error =
        refused_element(&format!("{before}{late}"), &["initialState, time: is uncertain by 1.0000, expected exact"]);
    assert_eq!(error.place().line, 1 + 4 + u32::try_from(before.matches('\n').count()).unwrap());
    let braking = format!("<acceleration>{}</acceleration><slipAngle>", interval(-6.0, 0.0));
    refused_element(&with("<slipAngle>", &braking), &["initialState, acceleration", "by 6", "0.01 m/s²"]);
    // both ends of a heading across the full turn
    refused_element(&with("<exact>0.01</exact>", &interval(3.1, -3.1)), &["orientation: is uncertain by 0.08"]);
}

#[test]
fn refuses_uncertain_states_of_obstacles() {
    let parked = "<point><x>1000030.0</x><y>1.0</y></point>";
    let wide = region(1_000_030.0, 1.0, 2.0);
    refused_element(&with(parked, &wide), &["staticObstacle 30, initialState, position: is uncertain by 2"]);
    let moved = "<point><x>1000001.0</x><y>1.75</y></point>";
    let wide = region(1_000_001.0, 1.75, 0.02);
    refused_element(&with(moved, &wide), &["dynamicObstacle 31, trajectory, state, position: is uncertain by 0.02"]);
    let time = ("<exact>3</exact>", interval(3.0, 4.0));
    refused_element(&with(time.0, &time.1), &["dynamicObstacle 31, trajectory, state, time: is uncertain by 1"]);
}

#[test]
fn refuses_negative_time_steps() {
    for (from, to, place) in [
        ("<exact>0</exact>", "<exact>-1</exact>", "staticObstacle 30, initialState, time, exact"),
        ("<exact>3</exact>", "<exact>-3</exact>", "dynamicObstacle 31, trajectory, state, time, exact"),
        ("<exact>1</exact>", "<exact>-1</exact>", "dynamicObstacle 32, occupancySet, occupancy, time, exact"),
        ("<intervalStart>0<", "<intervalStart>-5<", "phantomObstacle 34, occupancySet, occupancy, time, intervalStart"),
        ("<intervalStart>20<", "<intervalStart>-20<", "planningProblem 40, goalState, time, intervalStart"),
    ] {
        let error = refused_element(&with(from, to), &[place, "expected a time step of at least 0"]);
        assert_eq!(error.place().line as usize, line_of(from), "{error}");
    }
    let start = SMALL.find("<planningProblem").unwrap();
    let problem = SMALL[start..].replacen("<time><exact>0<", "<time><exact>-1<", 1);
    let text = format!("{}{problem}", &SMALL[..start]);
    refused_element(&text, &["planningProblem 40, initialState, time, exact: is \"-1\"", "at least 0"]);
}

#[test]
fn refuses_a_state_out_of_reach_of_the_one_before() {
    let state = "<x>1000001.0</x>";
    let line = line_of("<trajectory>") + 1;
    let far = refused_element(
        &with(state, "<x>6000000.0</x>"),
        &["dynamicObstacle 31, trajectory, state: is 5.0e6 m from the state before it", "at most 150 m/s"],
    );
    assert!(matches!(far, ElementError::Unreachable { .. }) && far.place().line as usize == line, "{far}");
    // the motion counts, not the place: 14 m in 0.1 s are 140 m/s
    assert!(read(&with(state, "<x>1000014.0</x>")).is_ok());
    refused_element(&with(state, "<x>1000016.0</x>"), &["16.0 m from the state before it, at 160 m/s"]);
    refused_element(&with("<exact>10.0<", "<exact>151<"), &["dynamicObstacle 31, initialState, velocity", "150 m/s"]);
}

#[test]
fn a_slip_angle_is_an_issue() {
    let slip = |angle: &str| with("<slipAngle><exact>0.0<", &format!("<slipAngle><exact>{angle}<"));
    noted(&slip("-0.3"), &["planningProblem 40, initialState: has a slip angle of -0.3 rad"]);
    assert_eq!(read(&slip("0.02")).unwrap().issues, [], "that of a turn");
}

#[test]
fn an_uncertainty_within_the_tolerance_is_an_issue() {
    let s = noted(
        &with("<point><x>1000001.0</x><y>1.75</y></point>", &region(1_000_001.5, 2.0, 0.009)),
        &["1 of 2 states are uncertain"],
    );
    let Motion::Trajectory(states) = &s.obstacles[1].motion else { panic!() };
    assert_eq!(states[1].pose.position, Point::new(1_000_001.5, 2.0));
    let s = noted(
        &with("<exact>8.0</exact>", &interval(7.99, 8.0)),
        &["planningProblem 40, initialState: is uncertain within the tolerances"],
    );
    assert_eq!(s.problems[0].initial.speed, 7.995);
    // an interval of no width is exact
    assert_eq!(read(&with("<exact>8.0</exact>", &interval(8.0, 8.0))).unwrap().issues, []);
    noted(&with("<exact>8.0</exact>", "<exact>-2.0</exact>"), &["rolls backwards at 2 m/s"]);
}

#[test]
fn an_obstacle_without_prediction_stands_still() {
    let start = SMALL.find("<trajectory>").unwrap();
    let end = SMALL.find("</trajectory>").unwrap() + "</trajectory>".len();
    let s = noted(&format!("{}{}", &SMALL[..start], &SMALL[end..]), &["dynamicObstacle 31: has no prediction"]);
    assert!(s.obstacles[1].is_static());
}

#[test]
fn sorts_states_and_derives_missing_headings_from_the_motion() {
    let swapped = SMALL.replace("<exact>3</exact>", "<exact>9</exact>");
    let s = noted(&swapped, &["not in order of time"]);
    let Motion::Trajectory(states) = &s.obstacles[1].motion else { panic!() };
    assert!(states.is_sorted_by(|a, b| a.time < b.time));
    noted(&swapped, &["has 1 gap(s) between its states, the longest of 5 time steps"]);

    let state = "<x>1000001.0</x><y>1.75</y></point></position>\n        <orientation><exact>0.0</exact></orientation>";
    let headless = with(state, "<x>1000002.0</x><y>0.75</y></point></position>");
    let s = noted(&headless, &["1 states have no orientation"]);
    let Motion::Trajectory(states) = &s.obstacles[1].motion else { panic!() };
    assert!((states[1].pose.yaw - FRAC_PI_2).abs() < 1e-9, "the next state is in y direction");

    let s = noted(
        &with("<exact>3</exact>", "<exact>2</exact>"),
        &["contradict the position of another state at the same time"],
    );
    let Motion::Trajectory(states) = &s.obstacles[1].motion else { panic!() };
    assert_eq!(states[0].pose.position.x, 1_000_000.0, "the initial state is kept");
}

#[test]
fn replaces_speeds_that_contradict_the_positions() {
    let s = noted(&SMALL.replace("<velocity><exact>10.0", "<velocity><exact>17.0"), &["3 speeds contradict"]);
    let Motion::Trajectory(states) = &s.obstacles[1].motion else { panic!() };
    assert!(states.iter().all(|s| (s.speed - 10.0).abs() < 1e-6), "{states:?}");
    let one = read(&with("<velocity><exact>10.0", "<velocity><exact>17.0")).unwrap();
    assert_eq!(one.issues, [], "a single one is kept");
}

#[test]
fn extends_sets_of_single_steps_over_gaps_but_not_adjacent_intervals() {
    let extended = super::obstacle::without_gaps(&[(0.0, 0.0), (1.0, 1.0), (1.0, 1.0), (4.0, 6.0), (6.0, 7.0)]);
    assert_eq!(extended, [(0.0, 1.0), (0.0, 4.0), (0.0, 4.0), (1.0, 6.0), (6.0, 7.0)]);
}

#[test]
fn reads_or_refuses_pathological_files_in_bounded_time() {
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
fn accepts_a_byte_order_mark_and_comments() {
    let s = read(&format!("\u{feff}{SMALL}")).unwrap();
    assert_eq!(s.issues, []);
    let s = read(&with("<exact>8.0</exact>", "<exact><!-- m/s --> 8<!-- and -->.5 </exact>")).unwrap();
    assert_eq!(s.problems[0].initial.speed, 8.5);
}

#[test]
fn reads_utf16_and_compressed_scenarios() {
    let utf16: Vec<u8> = SMALL.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    std::io::Write::write_all(&mut gzip, &utf16).unwrap();
    for bytes in [utf16, gzip.finish().unwrap()] {
        let s = super::read_from("-", bytes.as_slice()).unwrap();
        assert_eq!((s.obstacles.len(), s.issues), (5, vec![]));
    }
}

#[test]
fn names_a_file_that_cannot_be_read() {
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

/// The places of all errors: "line: element".
fn places(text: &str) -> Vec<String> {
    let ReadError::Elements(errors) = read(text).expect_err("must be refused") else { panic!("not of elements") };
    assert_eq!(errors.total(), errors.first().len());
    errors.first().iter().map(|e| format!("{}: {}", e.place().line, e.place().element)).collect()
}

#[test]
fn reports_all_errors_in_order_of_their_lines() {
    let edits = [
        ("timeStepSize=\"0.1\"", "timeStepSize=\"fast\""),
        ("<x>1000000.0</x><y>3.5</y>", "<x>NaN</x>"),
        ("<successor ref=\"2\"/>", "<successor ref=\"two\"/>"),
        ("<additionalValue>13.89</additionalValue>", "<additionalValue>fast</additionalValue>"),
        ("<duration>30</duration>", ""),
        ("<length>4.5</length><width>1.8</width>", "<length>0</length>"),
        ("<exact>0.25</exact>", "<exact>east</exact>"),
        ("<dynamicObstacle id=\"31\">", "<dynamicObstacle>"),
        ("<x>1000001.0</x>", "<x>?</x>"),
        ("<y>6.0</y>", "<y></y>"),
        ("<velocity><exact>8.0</exact></velocity>", ""),
        ("<intervalStart>20</intervalStart>", "<intervalStart>2.5</intervalStart>"),
        ("<exact>60</exact>", ""),
    ];
    let text = edits.iter().fold(SMALL.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    });
    assert_eq!(
        places(&text),
        [
            "2: commonRoad",
            "6: lanelet 1, leftBound, point, x",
            "6: lanelet 1, leftBound, point",
            "13: lanelet 1, successor",
            "43: trafficSign 10, trafficSignElement, additionalValue",
            "48: trafficLight 20, cycle, cycleElement",
            "55: staticObstacle 30, shape, rectangle, length",
            "55: staticObstacle 30, shape, rectangle",
            "58: staticObstacle 30, initialState, orientation, exact",
            "62: dynamicObstacle",
            "73: dynamicObstacle, trajectory, state, position, point, x",
            "95: dynamicObstacle 32, occupancySet, occupancy, shape, polygon, point, y",
            "117: planningProblem 40, initialState",
            "127: planningProblem 40, goalState, time, intervalStart",
            "133: planningProblem 40, goalState, time",
        ]
    );
    let message = read(&text).unwrap_err().to_string();
    assert_eq!(message.lines().count(), 15);
    assert!(message.lines().all(|line| line.starts_with("small.xml:")), "{message}");
}

#[test]
fn an_error_has_no_consequential_errors() {
    let one = |text: &str, place: &str, at: &str| assert_eq!(places(text), [format!("{}: {place}", line_of(at))]);
    // lanelet 2 is the goal of the planning problem, and the successor of lanelet 1
    let lanelet = "<lanelet id=\"2\">";
    let short = with("<point><x>1000100.0</x><y>0.0</y></point>", "");
    assert_eq!(places(&short), ["25: lanelet 2, rightBound"]);
    one(&with(lanelet, "<lanelet id=\"two\">"), "lanelet two", lanelet);
    one(&with(lanelet, "<lanelet>"), "lanelet", lanelet);
    // the file has a planning problem, although it is invalid
    let problem = "<planningProblem id=\"40\">";
    one(&with(problem, "<planningProblem id=\"x\">"), "planningProblem x", problem);
    // the obstacle has a shape, although it is unknown
    let circle = "<circle><radius>0.4</radius></circle>";
    one(&with(circle, "<blob/>"), "dynamicObstacle 32, shape, blob", circle);
    let static_obstacle = "<staticObstacle id=\"30\">";
    let renamed = with("<initialState>", "<state>").replacen("</initialState>", "</state>", 1);
    one(&renamed, "staticObstacle 30", static_obstacle);
}

#[test]
fn prints_the_first_errors_and_the_number_of_the_others() {
    let state = "<state><position><point><x>?</x></point></position><time/></state>\n";
    let text = with("<trajectory>", &format!("<trajectory>\n{}", state.repeat(5000)));
    let ReadError::Elements(errors) = read(&text).unwrap_err() else { panic!() };
    assert_eq!((errors.total(), errors.first().len()), (15_000, 1000));
    let first_line = line_of("<trajectory>") + 1;
    let lines: Vec<usize> = errors.first().iter().map(|e| e.place().line as usize).collect();
    assert!(lines.iter().enumerate().all(|(i, line)| *line == first_line + i / 3), "{lines:?}");
    let message = errors.to_string();
    assert_eq!(message.lines().count(), 21);
    assert!(message.ends_with("\n… and 14980 more"), "{message}");
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

/// Checks the guarantees of the reader.
fn assert_valid(s: &Scenario) {
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
                assert!(!o.occupied_at(t).is_empty(), "obstacle {} has no position at {t}", o.id);
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
    fn random_edits_never_panic_and_never_give_an_invalid_scenario(edits in edits()) {
        let text = edits.iter().fold(SMALL.to_owned(), |text, edit| if text.is_empty() { text } else { apply(&text, edit) });
        match read(&text) {
            Ok(scenario) => assert_valid(&scenario),
            Err(error) => prop_assert!(error.to_string().starts_with("small.xml")),
        }
    }
}
