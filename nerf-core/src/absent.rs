//! Methods of types that are uninhabited (enums without variants) in a build without their feature.

/// Declares the methods of an uninhabited type (an enum without variants) from signatures alone. The methods are never
/// called, since no `self` exists.
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
