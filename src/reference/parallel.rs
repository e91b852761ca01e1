//! Rows of a map shared out among the processor's cores.

use std::num::NonZero;
use std::thread;

/// Calls `work` with every row of `values` and its index.
pub fn for_each_row(values: &mut [f64], row_len: usize, work: impl Fn(usize, &mut [f64]) + Sync) {
    let threads = thread::available_parallelism().map_or(1, NonZero::get);
    let rows_each = (values.len() / row_len.max(1)).div_ceil(threads).max(1);
    thread::scope(|scope| {
        for (i, share) in values.chunks_mut(rows_each * row_len.max(1)).enumerate() {
            let work = &work;
            scope.spawn(move || {
                for (y, row) in share.chunks_mut(row_len).enumerate() {
                    work(i * rows_each + y, row);
                }
            });
        }
    });
}
