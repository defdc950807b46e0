//! Enums of choices whose variants are declared with their names in options and reports.

/// Declares an enum of choices; `ALL` has the order of declaration.
macro_rules! names {
    ($(#[$about:meta])* pub enum $choice:ident { $($(#[$doc:meta])* $variant:ident = $name:literal,)+ }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $choice {
            $($(#[$doc])* #[doc = concat!("\n`", $name, "`")] $variant,)+
        }

        impl $choice {
            /// Every choice, in the order of declaration.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$variant),+];

            /// Name of the choice in options and reports.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)+
                }
            }
        }
    };
}
pub(crate) use names;
