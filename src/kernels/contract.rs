//! What a kernel variant is: its shader, how it is compiled, what it needs and what it is specialised by. What the
//! shader itself declares, push constants and descriptors, `build.rs` reads off the compiled SPIR-V ([`super::spirv`]).

/// What a descriptor binding of set 0 holds. Storage buffers are not bound: they come as device addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BindingType {
    /// `texture2D`, read with `texelFetch`.
    SampledImage,
    /// `image2D`, written.
    StorageImage,
    /// `samplerBuffer` of four 32-bit floats a texel, read.
    TexelBuffer,
}

/// One descriptor of set 0; its binding number is its position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Binding {
    /// Its name in GLSL.
    pub name: &'static str,
    /// Type.
    pub ty: BindingType,
}

/// A specialisation constant; its id is its position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Constant {
    /// Name, the same in Rust and GLSL.
    pub name: &'static str,
    /// What the device fills it with.
    pub value: ConstantValue,
}

/// What fills a specialisation constant: a size of the device's cooperative matrices, or what the dispatch asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConstantValue {
    /// Invocations of so many subgroups.
    Subgroups(u32),
    /// Invocations of as many subgroups as it takes matrices for the rows of a window of 64 tokens.
    WindowInvocations,
    /// Rows of the first factor.
    MatrixRows,
    /// Columns of the second factor.
    MatrixColumns,
    /// Columns of the first factor.
    MatrixDepth,
    /// [`Specialisation::epilogue`].
    Epilogue,
    /// [`Specialisation::inner`].
    InnerEpilogue,
    /// Invocations of as many subgroups as a dense kernel's workgroup has.
    DenseInvocations,
    /// [`Specialisation::tiles`].
    Tiles,
    /// Subgroups that share a tile's tokens.
    Halves,
    /// [`Specialisation::inputs`].
    Inputs,
    /// [`Specialisation::keys`].
    Keys,
    /// [`Specialisation::values`].
    Values,
}

/// What a pipeline is specialised for: what becomes of sums before they are stored, and how a kernel on matrices cuts
/// its work. Zero where the kernel does not ask.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Specialisation {
    /// What becomes of the result's sums, by the flags of `glsl/shared/epilogue.glsl`.
    pub epilogue: u32,
    /// The same of what [`super::separable::Separable3x3`] computes between.
    pub inner: u32,
    /// Tiles of 8x8 tokens of a workgroup on matrices.
    pub tiles: u32,
    /// Whether there are so few workgroups that more subgroups are to share the tokens of a tile.
    pub few: bool,
    /// Input channels that it stages at a time.
    pub inputs: u32,
    /// Channels of queries and keys.
    pub keys: u32,
    /// Channels of values.
    pub values: u32,
}

/// How eight lanes of a subgroup hand round what they loaded (`glsl/shared/lanes.glsl`). Not a specialisation constant:
/// CPU drivers would compile indices that become constant only then to slower code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sharing {
    /// By `subgroupShuffle`.
    Shuffle,
    /// By `subgroupBroadcast`.
    Broadcast,
}

impl Sharing {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Shuffle, Self::Broadcast];

    /// What it adds to a variant's name.
    const fn suffix(self) -> &'static str {
        match self {
            Self::Shuffle => "",
            Self::Broadcast => "_broadcast",
        }
    }

    /// What its shader defines beyond the variant's own.
    const fn defines(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Shuffle => &[],
            Self::Broadcast => &[("BROADCAST", "1")],
        }
    }
}

/// One compiled module of a variant.
#[derive(Clone)]
pub struct Module {
    /// Unique name.
    pub name: String,
    /// Preprocessor definitions.
    pub defines: Vec<(&'static str, &'static str)>,
}

/// One compiled variant of a kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contract {
    /// Unique name of the variant, e.g. `conv3x3_s2`.
    pub name: &'static str,
    /// File in `glsl/`.
    pub source: &'static str,
    /// Preprocessor definitions that make this variant of the source.
    pub defines: &'static [(&'static str, &'static str)],
    /// The struct of its push constants ([`super::pushes`]).
    pub push: &'static str,
    /// The specialisation constants.
    pub constants: &'static [Constant],
    /// Device features beyond the portable set that the variant needs.
    pub needs: &'static [Need],
}

/// An optional device feature that a variant needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// `subgroupShuffle`, `subgroupBroadcast` and `subgroupVote` in compute shaders, at least 8 invocations a subgroup;
    /// `subgroupBroadcastDynamicId`; `shaderInt64`; texel buffers that may begin at every texel.
    CpuDriver,
    /// `storageBuffer16BitAccess`.
    Storage16,
    /// `shaderFloat16`.
    Float16,
    /// Cooperative matrices of halves with sums of 32-bit floats, and full subgroups of a fixed size.
    Matrix,
}

impl std::fmt::Display for Need {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::CpuDriver => {
                "subgroupShuffle over 8 lanes, subgroupVote, subgroupBroadcastDynamicId, shaderInt64 and \
                 minTexelBufferOffsetAlignment 16"
            }
            Self::Storage16 => "storageBuffer16BitAccess",
            Self::Float16 => "shaderFloat16",
            Self::Matrix => "VK_KHR_cooperative_matrix of halves summed in 32-bit floats by a subgroup",
        })
    }
}

impl Contract {
    /// The module of the variant for a device whose lanes share like this: the same for all where they do not.
    pub fn module(&self, sharing: Sharing) -> Module {
        let mut module = Module { name: self.name.to_owned(), defines: self.defines.to_vec() };
        if self.has("LANES_SHARE") {
            module.name += sharing.suffix();
            module.defines.extend(sharing.defines());
        }
        module
    }

    /// The number that the variant defines as `name`; 0 where it defines none.
    pub fn define(&self, name: &str) -> u64 {
        let value = self.defines.iter().find(|(key, _)| *key == name).and_then(|(_, value)| value.parse().ok());
        value.unwrap_or(0)
    }

    /// Whether the variant defines `name`.
    pub fn has(&self, name: &str) -> bool {
        self.defines.iter().any(|(key, _)| *key == name)
    }

    /// Whether it runs on cooperative matrices.
    pub fn needs_matrix(&self) -> bool {
        self.needs.contains(&Need::Matrix)
    }

    /// The kernel that it is a variant of: the name of its shader.
    pub fn kernel(&self) -> &'static str {
        self.source.trim_end_matches(".comp")
    }
}
