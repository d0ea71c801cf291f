//! Between rapier's `f32` vectors and the `f64` ones of everything else.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use rapier3d::math::{Matrix, Rotation, Vector};

pub(super) fn vector_to_sim(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x as f32, v.y as f32, v.z as f32)
}

pub(super) fn vector_from_sim(v: Vector) -> Vector3<f64> {
    Vector3::new(f64::from(v.x), f64::from(v.y), f64::from(v.z))
}

pub(super) fn matrix_to_sim(m: &Matrix3<f64>) -> Matrix {
    let column = |i: usize| vector_to_sim(&m.column(i).into_owned());
    Matrix::from_cols(column(0), column(1), column(2))
}

pub(super) fn rotation_to_sim(q: &UnitQuaternion<f64>) -> Rotation {
    Rotation::from_xyzw(q.i as f32, q.j as f32, q.k as f32, q.w as f32).normalize()
}

pub(super) fn rotation_from_sim(q: &Rotation) -> UnitQuaternion<f64> {
    let [x, y, z, w] = q.to_array().map(f64::from);
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_turn_vectors_alike_on_both_sides() {
        let ours = UnitQuaternion::from_euler_angles(0.3, -0.4, 1.2);
        let v = Vector3::new(0.1, -2.0, 0.7);
        let there = rotation_to_sim(&ours) * vector_to_sim(&v);
        assert!((vector_from_sim(there) - ours * v).norm() < 1e-6);
        assert!(rotation_from_sim(&rotation_to_sim(&ours)).angle_to(&ours) < 1e-6);
        let matrix = ours.to_rotation_matrix().into_inner();
        assert!((vector_from_sim(matrix_to_sim(&matrix) * vector_to_sim(&v)) - ours * v).norm() < 1e-6);
    }
}
