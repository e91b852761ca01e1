//! A kernel with its arguments, whichever it is.

use super::{Access, Grid, Kernel, Tiles, Traffic, View};

/// Declares [`Call`]: a variant of the enum for each kernel of the list.
macro_rules! calls {
    ($($(#[$doc:meta])* $name:ident($module:ident::$kernel:ident),)*) => {
        /// One kernel with its arguments.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Call {
            $($(#[$doc])* $name(super::$module::$kernel),)*
        }

        impl Call {
            /// The call as a kernel.
            pub fn kernel(&self) -> &dyn Kernel {
                match self {
                    $(Self::$name(kernel) => kernel,)*
                }
            }

            /// The same, to be changed.
            pub fn kernel_mut(&mut self) -> &mut dyn Kernel {
                match self {
                    $(Self::$name(kernel) => kernel,)*
                }
            }
        }
    };
}

super::for_kernels!(calls);

impl Call {
    /// The tokens that it works on; `None` for kernels that do not work tile by tile.
    pub fn grid(&self) -> Option<Grid> {
        self.kernel().grid()
    }

    /// Has it work on some tiles of its grid, if it has one.
    pub fn set_tiles(&mut self, tiles: Tiles) {
        self.kernel_mut().tiles_mut().into_iter().for_each(|own| *own = tiles);
    }

    /// The maps that it touches, and how.
    pub fn maps(&self) -> Vec<(View, Access)> {
        let mut found = Vec::new();
        self.clone().kernel_mut().maps(&mut |view, access| found.push((*view, access)));
        found
    }

    /// All maps that it writes.
    pub fn results(&self) -> Vec<View> {
        self.maps().into_iter().filter(|(_, access)| access.writes()).map(|(view, _)| view).collect()
    }

    /// The map that it writes, the first of several; `None` for kernels that write none.
    pub fn result(&self) -> Option<View> {
        self.results().first().copied()
    }

    /// Memory that it touches.
    pub fn traffic(&self) -> Traffic {
        let mut traffic = Traffic::default();
        for (view, access) in self.maps() {
            let touched = if access.writes() { &mut traffic.writes } else { &mut traffic.reads };
            touched.push((view.buffer, view.bytes()));
        }
        let others = self.kernel().others();
        traffic.reads.extend(others.reads);
        traffic.writes.extend(others.writes);
        traffic
    }
}
