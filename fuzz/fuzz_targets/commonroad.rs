//! Whatever the text, the CommonRoad reader gives a scenario or an error: no panic, no endless work. Start it with real
//! files as a corpus: `cargo +nightly fuzz run commonroad CORPUS maps`.

#![no_main]

libfuzzer_sys::fuzz_target!(|text: &str| {
    if let Ok(scenario) = stopline::io::commonroad::read_str("fuzz.xml", text) {
        for obstacle in &scenario.obstacles {
            let (from, to) = obstacle.lifetime();
            assert!(from <= to, "obstacle {} lives from {from} to {to}", obstacle.id);
            let _ = obstacle.occupied_at(from.max(0.0));
        }
    }
});
