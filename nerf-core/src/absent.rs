//! Methods of types that have no values in a build without their feature.

/// Declares, by their signatures, methods that are never called, since `self` cannot exist.
macro_rules! absent {
    ($($(#[$about:meta])* $visibility:vis fn $name:ident $(<$V:ident: $Bound:ident>)?(&self $(, $argument:ty)*) -> $result:ty;)+) => {$(
        $(#[$about])*
        #[allow(missing_docs, reason = "the type with the feature has them")]
        $visibility fn $name $(<$V: $Bound>)?(&self $(, _: $argument)*) -> $result {
            match *self {}
        }
    )+};
}
pub(crate) use absent;
