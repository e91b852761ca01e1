//! Structs that cross the boundary and may grow: the first field is the struct's size as the caller knows it.

use crate::status::Failure;
use std::mem::{MaybeUninit, size_of};
use std::ptr;

/// No descriptor is as large; what is was never set.
const MOST: usize = 1 << 12;

/// A struct of the interface that begins with `struct_size: usize`.
///
/// # Safety
/// `#[repr(C)]`, with `struct_size` first, of types that any bits are a value of, without padding.
pub unsafe trait Descriptor: Copy {
    /// Its name in C.
    const NAME: &'static str;
    /// Its size in the first version of the interface.
    const OLDEST: usize;
}

/// Makes a struct a [`Descriptor`]: its name in C, and the last field (with its type) of the first version.
macro_rules! descriptor {
    ($type:ident, $name:literal, $last:ident: $last_type:ty) => {
        // SAFETY: every use is a `#[repr(C)]` struct of numbers, arrays of numbers, pointers and optional function
        // pointers; a test holds the header's structs to have no padding.
        unsafe impl crate::descriptor::Descriptor for $type {
            const NAME: &'static str = $name;
            const OLDEST: usize = std::mem::offset_of!($type, $last) + size_of::<$last_type>();
        }
    };
}
pub(crate) use descriptor;

/// The size that a descriptor says it has.
///
/// # Errors
/// Where it is null, misaligned or of a size that no release gave it.
///
/// # Safety
/// `pointer` is null or points to a descriptor.
pub unsafe fn size_of_caller<T: Descriptor>(pointer: *const T) -> Result<usize, Failure> {
    if pointer.is_null() {
        return Err(Failure::argument(format!("a {} is NULL", T::NAME)));
    }
    if !pointer.is_aligned() {
        return Err(Failure::argument(format!("a {} lies at a misaligned address", T::NAME)));
    }
    // SAFETY: the caller's pointer is not null and aligned, and every descriptor begins with its size.
    let size = unsafe { pointer.cast::<usize>().read() };
    if !(T::OLDEST..=MOST).contains(&size) {
        return Err(Failure::argument(format!(
            "struct_size of a {0} is {size}; it must be sizeof({0}), at least {1}",
            T::NAME,
            T::OLDEST
        )));
    }
    Ok(size)
}

/// Reads a descriptor of this or another release. What an older header does not have is 0.
///
/// # Errors
/// Where it is null, its size is wrong, or a newer header's fields are set.
///
/// # Safety
/// `pointer` is null or points to as many bytes as its first field says.
pub unsafe fn read<T: Descriptor>(pointer: *const T) -> Result<T, Failure> {
    // SAFETY: as the caller's.
    let size = unsafe { size_of_caller(pointer)? };
    let mut value = MaybeUninit::<T>::zeroed();
    let known = size.min(size_of::<T>());
    // SAFETY: both hold that many bytes.
    unsafe { ptr::copy_nonoverlapping(pointer.cast::<u8>(), value.as_mut_ptr().cast::<u8>(), known) };
    for at in known..size {
        // SAFETY: within the caller's struct.
        if unsafe { pointer.cast::<u8>().add(at).read() } != 0 {
            return Err(Failure::argument(format!(
                "a {} has fields set that this library is too old for (vkdenoise {})",
                T::NAME,
                env!("CARGO_PKG_VERSION")
            )));
        }
    }
    // SAFETY: any bits are a value of a descriptor.
    Ok(unsafe { value.assume_init() })
}

/// The same, where null stands for all zeros.
///
/// # Errors
/// As [`read`].
///
/// # Safety
/// As [`read`].
pub unsafe fn read_or_default<T: Descriptor>(pointer: *const T) -> Result<T, Failure> {
    if pointer.is_null() {
        // SAFETY: any bits are a value of a descriptor.
        return Ok(unsafe { MaybeUninit::zeroed().assume_init() });
    }
    // SAFETY: as the caller's.
    unsafe { read(pointer) }
}

/// Reads an array of descriptors, each as far from the next as the first says it is large.
///
/// # Errors
/// As [`read`], where the array is null and not empty, and where sizes differ.
///
/// # Safety
/// `first` is null or points to as many descriptors.
pub unsafe fn read_all<T: Descriptor>(first: *const T, count: usize) -> Result<Vec<T>, Failure> {
    if count == 0 {
        return Ok(Vec::new());
    }
    // SAFETY: as the caller's; the same below.
    let size = unsafe { size_of_caller(first)? };
    let one = |at: usize| {
        // SAFETY: within the caller's array, as all before it have the same size.
        let place = first.cast::<u8>().wrapping_add(at * size).cast::<T>();
        // SAFETY: as above.
        unsafe {
            if size_of_caller(place)? != size {
                return Err(Failure::argument(format!("the descriptors of an array of {} differ in size", T::NAME)));
            }
            read(place)
        }
    };
    (0..count).map(one).collect()
}

/// Fills the caller's struct, as much of it as both know; the rest becomes 0.
///
/// # Errors
/// As [`read`] for null and sizes; nothing is written then.
///
/// # Safety
/// As [`read`], for writing.
pub unsafe fn write<T: Descriptor>(pointer: *mut T, value: &T) -> Result<(), Failure> {
    // SAFETY: as the caller's.
    let size = unsafe { size_of_caller(pointer.cast_const())? };
    let (known, first) = (size.min(size_of::<T>()), size_of::<usize>());
    // SAFETY: both hold that many bytes; the size itself stays the caller's.
    unsafe {
        let (from, to) = (ptr::from_ref(value).cast::<u8>(), pointer.cast::<u8>());
        ptr::copy_nonoverlapping(from.add(first), to.add(first), known - first);
        to.add(known).write_bytes(0, size - known);
    }
    Ok(())
}

/// Refuses a field that is kept for later and must be 0.
///
/// # Errors
/// Where it is not.
pub fn reserved<T: Descriptor>(value: u32) -> Result<(), Failure> {
    if value == 0 {
        return Ok(());
    }
    Err(Failure::argument(format!("reserved in a {} is {value}; it must be 0", T::NAME)))
}
