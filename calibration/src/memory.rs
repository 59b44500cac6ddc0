//! The memory that this process may still allocate.

/// Returns the number of bytes that are free for this process: the smaller of the kernel's and its control group's figure,
/// or `None` if neither is known.
pub fn available() -> Option<u64> {
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let free = read("/proc/meminfo").and_then(|text| mem_available(&text));
    let group = read("/sys/fs/cgroup/memory.max").zip(read("/sys/fs/cgroup/memory.current"));
    let group = group.and_then(|(most, used)| left_in_group(&most, &used));
    free.into_iter().chain(group).min()
}

/// Returns `MemAvailable` of `/proc/meminfo` in bytes; the file states it in kB.
fn mem_available(meminfo: &str) -> Option<u64> {
    let line = meminfo
        .lines()
        .find_map(|l| l.strip_prefix("MemAvailable:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kilobytes.checked_mul(1024)
}

/// Returns the bytes that a control group's limit leaves; `None` if the group has no limit.
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
