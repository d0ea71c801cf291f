//! The element-wise steps of the networks, in place on candle tensors and in the widest registers of the machine.
//!
//! Each element's result depends on that element alone, and no multiplication is fused with an addition, so the width of
//! the registers does not show in the bits.

#![expect(clippy::inline_always, reason = "vector code must be inlined into the function that has the features")]

use candle_core::{CpuStorage, InplaceOp1, InplaceOp2, Layout, Result, Storage, Tensor, bail};

/// What follows a layer's sum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Activation {
    /// Nothing.
    Linear,
    /// max(0, y)
    Relu,
    /// tanh y
    Tanh,
    /// tanh y, whose slope counts as 1 where the gradient points away from the nearer end, see [`Slope`].
    OpenTanh,
}

// Indices, because iterators are not inlined where there is much code around them.
impl Activation {
    /// `y ← f(y + b)`.
    #[inline(always)]
    pub(super) fn add_bias(self, y: &mut [f32], b: &[f32]) {
        let (n, b) = (y.len(), &b[..y.len()]);
        match self {
            Self::Linear => {
                for i in 0..n {
                    y[i] += b[i];
                }
            }
            Self::Relu => {
                for i in 0..n {
                    y[i] = relu(y[i] + b[i]);
                }
            }
            Self::Tanh | Self::OpenTanh => {
                for i in 0..n {
                    y[i] = (y[i] + b[i]).tanh();
                }
            }
        }
    }

    /// `d ← d · f′`, with f′ told from f's value y.
    #[inline(always)]
    pub(super) fn slope(self, d: &mut [f32], y: &[f32]) {
        let y = &y[..d.len()];
        match self {
            Self::Linear => (),
            Self::Relu => {
                for i in 0..d.len() {
                    let through = d[i];
                    d[i] = if y[i] > 0.0 { through } else { 0.0 };
                }
            }
            Self::Tanh => {
                for i in 0..d.len() {
                    d[i] *= 1.0 - y[i] * y[i];
                }
            }
            Self::OpenTanh => {
                for i in 0..d.len() {
                    let comes_back = d[i] * y[i] > 0.0;
                    d[i] *= if comes_back { 1.0 } else { 1.0 - y[i] * y[i] };
                }
            }
        }
    }
}

/// `d ← d · f′`, with f′ told from f's value y; d and y have one shape.
///
/// At an end of tanh f′ vanishes, and what has run into it never comes back, whatever is found elsewhere. The open one
/// keeps f′ where a step along −d would go further out, so that it does not run away, and takes 1 where it would come
/// back (after the inverted gradients of Hausknecht and Stone 2016).
pub(super) struct Slope(pub(super) Activation);

impl InplaceOp2 for Slope {
    fn name(&self) -> &'static str {
        "slope"
    }

    fn cpu_fwd(&self, d: &mut CpuStorage, d_at: &Layout, y: &CpuStorage, y_at: &Layout) -> Result<()> {
        let (d, y) = (slice_mut(d, d_at)?, slice(y, y_at)?);
        pulp::Arch::new().dispatch(|| self.0.slope(d, y));
        Ok(())
    }
}

/// `s ← Σ rows of d`, first row first; d is `[rows, n]`, s is `[n]`.
pub(super) struct SumRows;

impl InplaceOp2 for SumRows {
    fn name(&self) -> &'static str {
        "sum-rows"
    }

    fn cpu_fwd(&self, s: &mut CpuStorage, s_at: &Layout, d: &CpuStorage, d_at: &Layout) -> Result<()> {
        let (s, d) = (slice_mut(s, s_at)?, slice(d, d_at)?);
        pulp::Arch::new().dispatch(|| {
            s.fill(0.0);
            for row in d.chunks_exact(s.len()) {
                s.iter_mut().zip(row).for_each(|(s, d)| *s += d);
            }
        });
        Ok(())
    }
}

/// max(0, y) that lets NaN through, so that a poisoned weight cannot hide behind it.
#[inline]
fn relu(y: f32) -> f32 {
    if y < 0.0 { 0.0 } else { y }
}

/// Σ x² over a contiguous tensor, in an order fixed by index.
pub(super) fn sum_of_squares(x: &Tensor) -> Result<f32> {
    const LANES: usize = 32;
    let (storage, layout) = x.storage_and_layout();
    let x = numbers(&storage, layout)?;
    let mut sums = [0.0_f32; LANES];
    pulp::Arch::new().dispatch(|| {
        for chunk in x.chunks_exact(LANES) {
            for (sum, x) in sums.iter_mut().zip(chunk) {
                *sum += x * x;
            }
        }
    });
    let tail: f32 = x.chunks_exact(LANES).remainder().iter().map(|x| x * x).sum();
    Ok(sums.iter().sum::<f32>() + tail)
}

/// Lets `f` write the numbers of a contiguous f32 tensor.
pub(super) fn write(tensor: &Tensor, f: impl Fn(&mut [f32])) -> Result<()> {
    tensor.inplace_op1(&Write(f))
}

struct Write<F>(F);

impl<F: Fn(&mut [f32])> InplaceOp1 for Write<F> {
    fn name(&self) -> &'static str {
        "write"
    }

    fn cpu_fwd(&self, storage: &mut CpuStorage, layout: &Layout) -> Result<()> {
        (self.0)(slice_mut(storage, layout)?);
        Ok(())
    }
}

/// The numbers of a contiguous f32 tensor on the CPU.
pub(super) fn numbers<'a>(storage: &'a Storage, layout: &Layout) -> Result<&'a [f32]> {
    match storage {
        Storage::Cpu(storage) => slice(storage, layout),
        _ => bail!("a tensor off the CPU"),
    }
}

/// The numbers of a contiguous f32 tensor.
fn slice<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    let range = contiguous(layout)?;
    match storage {
        CpuStorage::F32(numbers) => Ok(&numbers[range]),
        _ => bail!("a tensor that is not f32"),
    }
}

/// The numbers of a contiguous f32 tensor, to be written.
pub(super) fn slice_mut<'a>(storage: &'a mut CpuStorage, layout: &Layout) -> Result<&'a mut [f32]> {
    let range = contiguous(layout)?;
    match storage {
        CpuStorage::F32(numbers) => Ok(&mut numbers[range]),
        _ => bail!("a tensor that is not f32"),
    }
}

fn contiguous(layout: &Layout) -> Result<std::ops::Range<usize>> {
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(start..end),
        None => bail!("a tensor of layout {layout:?}, expected a contiguous one"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    fn tensor(values: &[f32], shape: (usize, usize)) -> Tensor {
        Tensor::from_slice(values, shape, &Device::Cpu).unwrap()
    }

    fn vector(tensor: &Tensor) -> Vec<f32> {
        tensor.flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn bias_and_activation() {
        for (activation, expected) in [
            (Activation::Linear, [1.5, -3.0, -0.5, 2.0]),
            (Activation::Relu, [1.5, 0.0, 0.0, 2.0]),
            (Activation::Tanh, [1.5_f32.tanh(), (-3.0_f32).tanh(), (-0.5_f32).tanh(), 2.0_f32.tanh()]),
        ] {
            let mut y = [1.0, -2.0, -1.0, 3.0];
            activation.add_bias(&mut y, &[0.5, -1.0, 0.5, -1.0]);
            assert_eq!(y, expected, "{activation:?}");
        }
    }

    #[test]
    fn slopes() {
        let y = tensor(&[0.0, 0.5, 2.0, 0.0], (2, 2));
        for (activation, expected) in [
            (Activation::Linear, [1.0, 2.0, 3.0, 4.0]),
            (Activation::Relu, [0.0, 2.0, 3.0, 0.0]),
            (Activation::Tanh, [1.0, 1.5, -9.0, 4.0]),
            (Activation::OpenTanh, [1.0, 2.0, 3.0, 4.0]),
        ] {
            let d = tensor(&[1.0, 2.0, 3.0, 4.0], (2, 2));
            d.inplace_op2(&y, &Slope(activation)).unwrap();
            assert_eq!(vector(&d), expected, "{activation:?}");
        }
    }

    #[test]
    fn the_open_slope_holds_back_only_what_runs_out_of_the_box() {
        // A step goes along −d: the first two come back from the upper and the lower end, the others go further out.
        let y = tensor(&[1.0, -1.0, 1.0, -0.5], (1, 4));
        let d = tensor(&[2.0, -3.0, -2.0, 4.0], (1, 4));
        d.inplace_op2(&y, &Slope(Activation::OpenTanh)).unwrap();
        assert_eq!(vector(&d), [2.0, -3.0, 0.0, 3.0]);
    }

    #[test]
    fn sums_of_rows() {
        let s = Tensor::full(f32::NAN, 2, &Device::Cpu).unwrap();
        s.inplace_op2(&tensor(&[1.0, 2.0, 3.0, 4.0, -5.0, 0.5], (3, 2)), &SumRows).unwrap();
        assert_eq!(vector(&s), [-1.0, 6.5]);
    }

    #[test]
    fn squares_and_what_is_not_finite() {
        for n in [0, 1, 31, 32, 33, 100] {
            let x: Vec<f32> = (0..n).map(|i| i as f32).collect();
            let expected: f32 = x.iter().map(|x| x * x).sum();
            assert_eq!(sum_of_squares(&tensor(&x, (1, n))).unwrap(), expected, "{n}");
        }
        for bad in [f32::NAN, f32::INFINITY] {
            assert!(!sum_of_squares(&tensor(&[1.0, bad], (1, 2))).unwrap().is_finite());
            let mut y = [bad];
            Activation::Relu.add_bias(&mut y, &[0.0]);
            assert!(!y[0].is_finite(), "ReLU hides {bad}");
        }
    }
}
