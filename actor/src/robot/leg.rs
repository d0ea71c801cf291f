//! The four legs and their order: FL, FR, RL, RR, as in every table of the spaces.

use herd_common::spaces::LEGS;

/// A leg.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Leg {
    /// Front left.
    FrontLeft,
    /// Front right.
    FrontRight,
    /// Rear left.
    RearLeft,
    /// Rear right.
    RearRight,
}

impl Leg {
    /// Every leg, in index order.
    pub const ALL: [Self; LEGS] = [Self::FrontLeft, Self::FrontRight, Self::RearLeft, Self::RearRight];

    /// Position in arrays of legs.
    pub fn index(self) -> usize {
        self as usize
    }

    /// +1 on the left (body +y), −1 on the right.
    pub fn side(self) -> f64 {
        match self {
            Self::FrontLeft | Self::RearLeft => 1.0,
            Self::FrontRight | Self::RearRight => -1.0,
        }
    }

    /// +1 in front (body +x), −1 behind.
    pub fn front(self) -> f64 {
        match self {
            Self::FrontLeft | Self::FrontRight => 1.0,
            Self::RearLeft | Self::RearRight => -1.0,
        }
    }

    /// The leg that this one becomes in a mirror along the body's xz plane.
    pub fn mirrored(self) -> Self {
        match self {
            Self::FrontLeft => Self::FrontRight,
            Self::FrontRight => Self::FrontLeft,
            Self::RearLeft => Self::RearRight,
            Self::RearRight => Self::RearLeft,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn legs_stand_where_their_names_say() {
        for (index, leg) in Leg::ALL.into_iter().enumerate() {
            assert_eq!(leg.index(), index);
            assert_eq!(leg.mirrored().mirrored(), leg);
            assert_eq!((leg.mirrored().side(), leg.mirrored().front()), (-leg.side(), leg.front()));
        }
        assert_eq!((Leg::FrontLeft.front(), Leg::RearRight.side()), (1.0, -1.0));
    }
}
