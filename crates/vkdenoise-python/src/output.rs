//! The array that is written.

use crate::arrays::{Floats, Input, Span, tuple};
use numpy::{PyArrayMethods, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PySlice;
use vkdenoise::{Plane, PlaneMut, Region, SamplesMut};

/// The array that is written, and what the caller gets.
pub struct Output<'py> {
    written: Floats<'py>,
    span: Span,
    /// The caller's array, where it cannot be written in place: it takes the pixels at the end.
    copied_to: Option<Floats<'py>>,
    result: Bound<'py, PyAny>,
}

impl<'py> Output<'py> {
    /// A new array of the colour's shape and type; the colour itself wherever `region` leaves it out.
    pub fn new(color: &Input<'py>, region: Option<Region>) -> PyResult<Self> {
        let written = match region {
            Some(_) => color.array().copied()?,
            None => color.array().dense()?,
        };
        let result = written.untyped().as_any().clone();
        Self::of(written, None, result)
    }

    /// The caller's array; `inputs` are read at the same time.
    pub fn given(object: &Bound<'py, PyAny>, inputs: &[&Input<'py>]) -> PyResult<Self> {
        let array = Floats::view_to_write("out", object)?;
        let wanted = inputs.first().map_or(&[][..], |color| color.array().shape());
        if array.shape() != wanted {
            let (found, wanted) = (tuple(array.shape()), tuple(wanted));
            return Err(PyValueError::new_err(format!("out has shape {found}; color's, {wanted}, is wanted")));
        }
        let sizes = array.shape().iter().zip(array.untyped().strides());
        if sizes.into_iter().any(|(&size, &stride)| size > 1 && stride == 0) {
            return Err(PyValueError::new_err(
                "out is broadcast, several of its pixels are one; give one with its own",
            ));
        }
        let in_place = array.span().filter(|span| {
            let addresses = array.addresses(span);
            !inputs.iter().any(|input| input.overlaps(&addresses))
        });
        match in_place {
            Some(span) => Ok(Self { written: array, span, copied_to: None, result: object.clone() }),
            None => Self::of(array.dense()?, Some(array), object.clone()),
        }
    }

    fn of(written: Floats<'py>, copied_to: Option<Floats<'py>>, result: Bound<'py, PyAny>) -> PyResult<Self> {
        let span = written.span().ok_or_else(|| PyValueError::new_err("numpy's new array is not dense"))?;
        Ok(Self { written, span, copied_to, result })
    }

    /// The samples as the library takes them.
    pub fn plane(&mut self) -> PlaneMut<'_> {
        let Span { layout, samples } = self.span;
        // SAFETY, of both: as of `Input::plane`; the array can be written, and overlaps none that is read.
        match &self.written {
            Floats::F32(array) => {
                PlaneMut::f32(unsafe { std::slice::from_raw_parts_mut(array.data(), samples) }, layout)
            }
            Floats::F16(array) => {
                PlaneMut::f16(unsafe { std::slice::from_raw_parts_mut(array.data(), samples) }, layout)
            }
        }
    }

    /// What the caller gets, with the pixels of the region in it.
    pub fn finish(self, region: Region) -> PyResult<Bound<'py, PyAny>> {
        if let Some(to) = &self.copied_to {
            let py = self.result.py();
            let range = |from: u32, to: u32| PySlice::new(py, from as isize, to as isize, 1);
            let part = (range(region.y, region.bottom()), range(region.x, region.right()));
            let from = self.written.untyped().as_any().get_item(&part)?;
            to.untyped().as_any().set_item(part, from)?;
        }
        Ok(self.result)
    }
}

/// The same plane for a shorter time.
pub fn reborrow<'a>(plane: &'a mut PlaneMut<'_>) -> PlaneMut<'a> {
    match &mut plane.samples {
        SamplesMut::F32(samples) => PlaneMut::f32(samples, plane.layout),
        SamplesMut::F16(samples) => PlaneMut::f16(samples, plane.layout),
    }
}

/// A plane that was written, to be read.
pub fn as_read<'a>(plane: &'a PlaneMut<'_>) -> Plane<'a> {
    match &plane.samples {
        SamplesMut::F32(samples) => Plane::f32(samples, plane.layout),
        SamplesMut::F16(samples) => Plane::f16(samples, plane.layout),
    }
}
