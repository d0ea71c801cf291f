//! What a network's numbers are called: rows that are laid out alike, spans within one, as snapshots and exports have them.

/// The rows of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Row {
    /// θ, what is learned.
    Online,
    /// θ′, which follows slowly.
    Target,
    /// m, Adam's mean of gradients.
    Mean,
    /// v, Adam's mean of squared gradients.
    Square,
    /// g, of the last backward pass; means nothing between updates.
    Gradient,
}

impl Row {
    /// Rows of a network.
    pub(super) const COUNT: usize = 5;
    /// The rows that last from one update to the next.
    pub(super) const LASTING: [Self; 4] = [Self::Online, Self::Target, Self::Mean, Self::Square];

    /// The name in snapshots.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Online => "online",
            Self::Target => "target",
            Self::Mean => "mean",
            Self::Square => "square",
            Self::Gradient => "gradient",
        }
    }
}

/// One weight or bias: where it stands in a row, and its shape there.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Span {
    /// Such as `0.weight`.
    pub(super) name: String,
    /// First number within the row.
    pub(super) start: usize,
    /// `[inputs, outputs]` or `[outputs]`.
    pub(super) shape: Vec<usize>,
}

impl Span {
    /// Numbers in it.
    pub(super) fn len(&self) -> usize {
        self.shape.iter().product()
    }
}

/// Numbers in all of them.
pub(super) fn parameters(spans: &[Span]) -> usize {
    spans.iter().map(Span::len).sum()
}

/// The weights and biases of a network of these widths, one behind the other.
pub(super) fn spans(widths: &[usize]) -> Vec<Span> {
    let mut spans: Vec<Span> = Vec::new();
    for (i, pair) in widths.windows(2).enumerate() {
        for (kind, shape) in [("weight", vec![pair[0], pair[1]]), ("bias", vec![pair[1]])] {
            spans.push(Span { name: format!("{i}.{kind}"), start: parameters(&spans), shape });
        }
    }
    spans
}
