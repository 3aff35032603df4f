//! CPU time of this process.

/// Seconds of user and system that this process has used on all its threads, in hundredths; 0 where the system does not tell (Linux does:
/// fields 14 and 15 of /proc/self/stat).
#[must_use]
pub fn seconds() -> f64 {
    used(&std::fs::read_to_string("/proc/self/stat").unwrap_or_default(), 11)
}

/// Seconds that the living threads of this process have used, in nanoseconds (`schedstat` of each): for what takes less than the hundredths of
/// [`seconds`] and starts no threads of its own; 0 where the system does not tell.
#[must_use]
pub fn of_living_threads_s() -> f64 {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return 0.0 };
    tasks
        .filter_map(Result::ok)
        .filter_map(|task| std::fs::read_to_string(task.path().join("schedstat")).ok())
        .filter_map(|text| text.split_whitespace().next()?.parse::<f64>().ok())
        .sum::<f64>()
        * 1e-9
}

/// The same as [`seconds`] of its children that have ended.
#[must_use]
pub fn of_children_s() -> f64 {
    used(&std::fs::read_to_string("/proc/self/stat").unwrap_or_default(), 13)
}

/// Two fields of a line of `stat`, counted from the one behind the state; the name before it may hold blanks and brackets.
fn used(stat: &str, first: usize) -> f64 {
    let behind = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
    let ticks = |k: usize| behind.split_whitespace().nth(k).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(first) + ticks(first + 1)) / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn user_and_system_are_added_whatever_the_name_is() {
        let stat = "7 (a) b (c) R 1 2 3 4 5 6 7 8 9 10 250 50 30 20 20 0";
        assert!((used(stat, 11) - 3.0).abs() < 1e-12 && (used(stat, 13) - 0.5).abs() < 1e-12);
        assert!(used("", 11) == 0.0);
    }
}
