//! For any bytes, the CommonRoad reader gives a scenario or an error: it does not panic, and its work is bounded. Run it with
//! real files as a corpus: `cargo +nightly fuzz run commonroad CORPUS maps`.

#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(scenario) = stopline::io::commonroad::read_bytes("fuzz.xml", bytes.to_vec()) {
        for obstacle in &scenario.obstacles {
            let (from, to) = obstacle.lifetime();
            assert!(from <= to, "obstacle {} exists from {from} to {to}", obstacle.id);
            let _ = obstacle.occupied_at(from.max(0.0));
        }
    }
});
