//! The memory that this process may still take.

/// Bytes that are free for this process, by the kernel and by its control group; `None` where neither says.
pub fn available() -> Option<u64> {
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let free = read("/proc/meminfo").and_then(|text| mem_available(&text));
    let group = read("/sys/fs/cgroup/memory.max").zip(read("/sys/fs/cgroup/memory.current"));
    let group = group.and_then(|(most, used)| left_in_group(&most, &used));
    free.into_iter().chain(group).min()
}

/// `MemAvailable` of `/proc/meminfo`, which is in kB.
fn mem_available(meminfo: &str) -> Option<u64> {
    let line = meminfo
        .lines()
        .find_map(|l| l.strip_prefix("MemAvailable:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kilobytes.checked_mul(1024)
}

/// What a control group leaves; `None` without a limit.
fn left_in_group(most: &str, used: &str) -> Option<u64> {
    let number = |text: &str| text.trim().parse::<u64>().ok();
    Some(number(most)?.saturating_sub(number(used)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_linux_writes_is_read() {
        let meminfo = "MemTotal:       24600000 kB\nMemFree:  1 kB\nMemAvailable:   20000000 kB\n";
        assert_eq!(mem_available(meminfo), Some(20_000_000 * 1024));
        assert_eq!(mem_available("MemTotal: 1 kB\n"), None);
        assert_eq!(left_in_group("max\n", "1000\n"), None);
        assert_eq!(left_in_group("5000\n", "1000\n"), Some(4000));
        assert_eq!(left_in_group("5000\n", "6000\n"), Some(0));
    }
}
