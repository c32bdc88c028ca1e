//! Workers: independent jobs in parallel, with results that do not depend on their number.
//!
//! Every worker has its own thread pool. The planner searches as many paths in parallel as its pool has threads and discards
//! a part of this work, which is free only while other cores are idle. So a job gets one thread as long as there are more
//! jobs than workers. In a shared pool a worker would begin a second job while it waits inside the first one, which would distort
//! all times.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Number of cores.
pub(crate) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Calls `work` for every item, `jobs` at a time, and returns the results in the order of the items. Once `stop` says so, no
/// further item begins, and those that did not begin have no result.
pub(crate) fn in_order<T: Sync, R: Send>(
    jobs: usize,
    items: &[T],
    stop: &(dyn Fn() -> bool + Sync),
    work: impl Fn(&T) -> R + Sync,
) -> Result<Vec<R>, rayon::ThreadPoolBuildError> {
    let workers = jobs.min(items.len()).max(1);
    let threads = (jobs / workers).max(1);
    let next = AtomicUsize::new(0);
    let results: Mutex<BTreeMap<usize, R>> = Mutex::new(BTreeMap::new());
    let take_and_work = || {
        while !stop() {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else { break };
            let result = work(item);
            results.lock().unwrap_or_else(PoisonError::into_inner).insert(index, result);
        }
    };
    let pool = |_| rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pools = (0..workers).map(pool).collect::<Result<Vec<_>, _>>()?;
    std::thread::scope(|scope| {
        for pool in &pools {
            scope.spawn(|| pool.install(take_and_work));
        }
    });
    Ok(results.into_inner().unwrap_or_else(PoisonError::into_inner).into_values().collect())
}
