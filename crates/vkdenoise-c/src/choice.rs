//! Enums and truth values that come in as numbers: any number may.

use crate::status::Failure;

/// What the number of a C enum stands for.
///
/// # Errors
/// Where it is none of the enum's: `name` is the field's, `kind` the enum's.
pub fn choice<T: Copy>(value: u32, name: &str, kind: &str, values: &[(u32, T)]) -> Result<T, Failure> {
    let found = values.iter().find(|(number, _)| *number == value);
    found
        .map(|(_, meaning)| *meaning)
        .ok_or_else(|| Failure::argument(format!("{name} is {value}; it must be a {kind}")))
}

/// A truth value of C.
///
/// # Errors
/// Where it is neither 0 nor 1.
pub fn flag(value: u32, name: &str) -> Result<bool, Failure> {
    match value {
        0 => Ok(false),
        1 => Ok(true),
        other => Err(Failure::argument(format!("{name} is {other}; it must be 0 or 1"))),
    }
}
