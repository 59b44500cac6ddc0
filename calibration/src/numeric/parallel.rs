//! Parallel work on all cores, in chunks whose results are returned in order or in independent tasks. No result depends on
//! the number of threads.

use std::sync::Mutex;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use crate::progress::{limit_threads, thread_limit};

/// Capacity, for each thread, of the queue of items to process and of the queue of results to take.
const WAITING: usize = 2;

/// Passes every item of `next` to `work` on one of `threads` threads, and every result to `take` in the order of the items.
///
/// `next` and `take` run on the calling thread. Only a few items for each thread exist at a time, so a file of any length
/// takes constant memory. With one thread, all work runs on the calling thread.
///
/// # Errors
/// The first error of `take` in the order of the items, otherwise that of `next`. No further item is requested then.
///
/// # Panics
/// When `work` does.
pub fn in_order<I: Send, O: Send, E>(
    threads: usize,
    mut next: impl FnMut() -> Result<Option<I>, E>,
    work: impl Fn(I) -> O + Sync,
    mut take: impl FnMut(O) -> Result<(), E>,
) -> Result<(), E> {
    if threads <= 1 {
        while let Some(item) = next()? {
            take(work(item))?;
        }
        return Ok(());
    }
    let limit = thread_limit();
    std::thread::scope(|scope| {
        let work = &work;
        let worker = |_| -> (SyncSender<I>, Receiver<O>) {
            let (give, items) = sync_channel(WAITING);
            let (done, results) = sync_channel(WAITING);
            scope.spawn(move || {
                let _limit = limit_threads(limit);
                // After an error no more results are taken, and sending fails.
                let _ = items.into_iter().try_for_each(|item| done.send(work(item)));
            });
            (give, results)
        };
        let workers: Vec<_> = (0..threads).map(worker).collect();
        let (mut given, mut taken) = (0, 0);
        // Only a panic closes a channel early; the end of the scope propagates it.
        let mut take_one = |taken: &mut usize| -> Result<(), E> {
            let (_, results) = &workers[*taken % threads];
            *taken += 1;
            results.recv().map_or(Ok(()), &mut take)
        };
        let end = loop {
            match next() {
                Ok(Some(item)) => {
                    if given - taken == WAITING * threads {
                        take_one(&mut taken)?;
                    }
                    let _ = workers[given % threads].0.send(item);
                    given += 1;
                }
                Ok(None) => break Ok(()),
                Err(error) => break Err(error),
            }
        };
        while taken < given {
            take_one(&mut taken)?;
        }
        end
    })
}

/// Runs `work` on every task, starting with the first, each on the next free one of `threads` threads.
///
/// # Panics
/// When `work` does.
pub fn for_each<T: Send>(threads: usize, tasks: Vec<T>, work: impl Fn(T) + Sync) {
    let threads = threads.min(tasks.len());
    if threads <= 1 {
        tasks.into_iter().for_each(work);
        return;
    }
    let queue = Mutex::new(tasks.into_iter());
    // The lock fails only after a panic of another thread, which ends the scope anyway.
    let next = || queue.lock().ok().and_then(|mut tasks| tasks.next());
    let limit = thread_limit();
    let take_all = || {
        let _limit = limit_threads(limit);
        while let Some(task) = next() {
            work(task);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads {
            scope.spawn(take_all);
        }
        take_all();
    });
}

/// Number of items in a chunk when results are collected.
const TOGETHER: usize = 256;

/// Returns the results of `work` for all items, in their order, computed on `threads` threads. A few items start no thread.
///
/// # Panics
/// When `work` does.
pub fn map_all<I: Sync, O: Send>(
    threads: usize,
    items: &[I],
    work: impl Fn(&I) -> O + Sync,
) -> Vec<O> {
    let mut out = Vec::with_capacity(items.len());
    for_numbers(threads, items.len(), |i| work(&items[i]), |o| out.push(o));
    out
}

/// Runs `work` on every number below `count`, each on one of `threads` threads, and passes the results to `take` in the
/// order of the numbers, on the calling thread. A few numbers start no thread.
///
/// # Panics
/// When `work` does.
pub fn for_numbers<O: Send>(
    threads: usize,
    count: usize,
    work: impl Fn(usize) -> O + Sync,
    mut take: impl FnMut(O),
) {
    let mut chunks = (0..count).step_by(TOGETHER);
    let Ok(()): Result<(), std::convert::Infallible> = in_order(
        threads.min(chunks.len()),
        || Ok(chunks.next()),
        |first| {
            let numbers = first..count.min(first + TOGETHER);
            numbers.map(&work).collect::<Vec<O>>()
        },
        |results| {
            results.into_iter().for_each(&mut take);
            Ok(())
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Results of items 0 to `count`, where chunk `refused` is refused and the items end in an error at `broken`.
    fn run(
        threads: usize,
        count: usize,
        refused: usize,
        broken: usize,
    ) -> (Vec<usize>, Result<(), usize>) {
        let (mut given, mut out) = (0, Vec::new());
        let next = || {
            let item = given;
            given += 1;
            match item {
                _ if item == broken => Err(1_000_000 + item),
                _ => Ok((item < count).then_some(item)),
            }
        };
        let work = |item: usize| {
            // Early items take longest.
            std::thread::sleep(std::time::Duration::from_micros(200 / (1 + item as u64)));
            item * item
        };
        let end = in_order(threads, next, work, |result| {
            if result == refused * refused {
                return Err(refused);
            }
            out.push(result);
            Ok(())
        });
        (out, end)
    }

    #[test]
    fn the_order_is_that_of_the_items() {
        const NEVER: usize = usize::MAX >> 33;
        for count in [0, 1, 2, 7, 100] {
            for (refused, broken) in [(NEVER, NEVER), (5, NEVER), (NEVER, 6), (5, 6), (3, 3)] {
                let one = run(1, count, refused, broken);
                for threads in [2, 3, 16] {
                    assert_eq!(
                        run(threads, count, refused, broken),
                        one,
                        "{threads} {count}"
                    );
                }
            }
        }
        assert_eq!(
            run(2, 100, 5, NEVER),
            ((0..5).map(|i| i * i).collect(), Err(5))
        );
    }

    #[test]
    fn every_number_comes_once_and_in_order() {
        for count in [0, 1, TOGETHER - 1, TOGETHER, TOGETHER + 1, 5 * TOGETHER + 7] {
            for threads in [1, 2, 3] {
                let mut out = Vec::new();
                for_numbers(threads, count, |i| 3 * i, |result| out.push(result));
                let expected: Vec<usize> = (0..count).map(|i| 3 * i).collect();
                assert_eq!(out, expected, "{threads} {count}");
                let items: Vec<usize> = (0..count).collect();
                assert_eq!(map_all(threads, &items, |i| 3 * i), expected);
            }
        }
    }
}
