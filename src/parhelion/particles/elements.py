"""The chemical elements as they are drawn: symbol, colour, van der Waals and covalent radius.

Sources of the figures:

colour      the Jmol element colours (jmol.sourceforge.net/jscolors), 8-bit sRGB
van der     A. Bondi, J. Phys. Chem. 68 (1964) 441, for the non-metals and Si, As, Te;
Waals       M. Mantina et al., J. Phys. Chem. A 113 (2009) 5806, for Po, At, Rn, Fr, Ra;
            S. Alvarez, Dalton Trans. 42 (2013) 8617, for all others
covalent    B. Cordero et al., Dalton Trans. (2008) 2832; C is sp3, Mn, Fe, Co are low spin

Radii are in angstrom. A dash is a value that none of these publishes.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

# In the order of the atomic number, from 1: symbol, sRGB, van der Waals radius, covalent radius.
_TABLE = """
H  FFFFFF 1.20 0.31
He D9FFFF 1.40 0.28
Li CC80FF 2.12 1.28
Be C2FF00 1.98 0.96
B  FFB5B5 1.91 0.84
C  909090 1.70 0.76
N  3050F8 1.55 0.71
O  FF0D0D 1.52 0.66
F  90E050 1.47 0.57
Ne B3E3F5 1.54 0.58
Na AB5CF2 2.50 1.66
Mg 8AFF00 2.51 1.41
Al BFA6A6 2.25 1.21
Si F0C8A0 2.10 1.11
P  FF8000 1.80 1.07
S  FFFF30 1.80 1.05
Cl 1FF01F 1.75 1.02
Ar 80D1E3 1.88 1.06
K  8F40D4 2.73 2.03
Ca 3DFF00 2.62 1.76
Sc E6E6E6 2.58 1.70
Ti BFC2C7 2.46 1.60
V  A6A6AB 2.42 1.53
Cr 8A99C7 2.45 1.39
Mn 9C7AC7 2.45 1.39
Fe E06633 2.44 1.32
Co F090A0 2.40 1.26
Ni 50D050 2.40 1.24
Cu C88033 2.38 1.32
Zn 7D80B0 2.39 1.22
Ga C28F8F 2.32 1.22
Ge 668F8F 2.29 1.20
As BD80E3 1.85 1.19
Se FFA100 1.90 1.20
Br A62929 1.85 1.20
Kr 5CB8D1 2.02 1.16
Rb 702EB0 3.21 2.20
Sr 00FF00 2.84 1.95
Y  94FFFF 2.75 1.90
Zr 94E0E0 2.52 1.75
Nb 73C2C9 2.56 1.64
Mo 54B5B5 2.45 1.54
Tc 3B9E9E 2.44 1.47
Ru 248F8F 2.46 1.46
Rh 0A7D8C 2.44 1.42
Pd 006985 2.15 1.39
Ag C0C0C0 2.53 1.45
Cd FFD98F 2.49 1.44
In A67573 2.43 1.42
Sn 668080 2.42 1.39
Sb 9E63B5 2.47 1.39
Te D47A00 2.06 1.38
I  940094 1.98 1.39
Xe 429EB0 2.16 1.40
Cs 57178F 3.48 2.44
Ba 00C900 3.03 2.15
La 70D4FF 2.98 2.07
Ce FFFFC7 2.88 2.04
Pr D9FFC7 2.92 2.03
Nd C7FFC7 2.95 2.01
Pm A3FFC7    - 1.99
Sm 8FFFC7 2.90 1.98
Eu 61FFC7 2.87 1.98
Gd 45FFC7 2.83 1.96
Tb 30FFC7 2.79 1.94
Dy 1FFFC7 2.87 1.92
Ho 00FF9C 2.81 1.92
Er 00E675 2.83 1.89
Tm 00D452 2.79 1.90
Yb 00BF38 2.80 1.87
Lu 00AB24 2.74 1.87
Hf 4DC2FF 2.63 1.75
Ta 4DA6FF 2.53 1.70
W  2194D6 2.57 1.62
Re 267DAB 2.49 1.51
Os 266696 2.48 1.44
Ir 175487 2.41 1.41
Pt D0D0E0 2.29 1.36
Au FFD123 2.32 1.36
Hg B8B8D0 2.45 1.32
Tl A6544D 2.47 1.45
Pb 575961 2.60 1.46
Bi 9E4FB5 2.54 1.48
Po AB5C00 1.97 1.40
At 754F45 2.02 1.50
Rn 428296 2.20 1.50
Fr 420066 3.48 2.60
Ra 007D00 2.83 2.21
Ac 70ABFA 2.80 2.15
Th 00BAFF 2.93 2.06
Pa 00A1FF 2.88 2.00
U  008FFF 2.71 1.96
Np 0080FF 2.82 1.90
Pu 006BFF 2.81 1.87
Am 545CF2 2.83 1.80
Cm 785CE3 3.05 1.69
Bk 8A4FE3 3.40    -
Cf A136D4 3.05    -
Es B31FD4 2.70    -
Fm B31FBA    -    -
Md B30DA6    -    -
No BD0D87    -    -
Lr C70066    -    -
Rf CC0059    -    -
Db D1004F    -    -
Sg D90045    -    -
Bh E00038    -    -
Hs E6002E    -    -
Mt EB0026    -    -
Ds      -    -    -
Rg      -    -    -
Cn      -    -    -
Nh      -    -    -
Fl      -    -    -
Mc      -    -    -
Lv      -    -    -
Ts      -    -    -
Og      -    -    -
"""

# Number 0 is an atom of no element: a dummy, a virtual site. Its colour is the one by which Jmol
# marks what it does not know; its radii, and what a dash becomes, are our own choice.
_ROWS = [row.split() for row in ("X FF1493 1.00 0.50" + _TABLE).splitlines()]


def _radii(column: int, unpublished: float) -> NDArray[np.float64]:
    return np.array([unpublished if row[column] == "-" else float(row[column]) for row in _ROWS])


# By atomic number, 0 to 118. Colours are (119, 3) 8-bit sRGB, radii (119,) in angstrom.
SYMBOLS = tuple(row[0] for row in _ROWS)
COLORS = np.array([list(bytes.fromhex(row[1].replace("-", "FF1493"))) for row in _ROWS], np.uint8)
VDW_RADII = _radii(2, unpublished=2.9)
COVALENT_RADII = _radii(3, unpublished=1.7)

_NUMBERS = {symbol.upper(): number for number, symbol in enumerate(SYMBOLS)}
_NUMBERS |= {"D": 1, "T": 1}  # deuterium, tritium
_NUMBERS |= dict.fromkeys(("XX", "DU", "BQ", "Q", "VA", "LP"), 0)  # what programs call dummies

# Molecules and noble gases; whatever has more of other elements than of these is taken for a
# metal, a salt or a mineral, where van der Waals spheres hide each other.
_MOLECULES = "X H He C N O F Ne P S Cl Ar Se Br Kr I Xe Rn"
MOLECULAR = np.isin(SYMBOLS, _MOLECULES.split())

# Two letters that are the symbol of an element but name another atom in proteins, nucleic acids
# and haems, as CA (alpha carbon), HG (gamma hydrogen), NA (pyrrole nitrogen), PB (phosphate).
_OTHERS = "CA CD CE CS HE HF HG HO HS NA NB ND NE NP PA PB SG"
_NAMES_OF_OTHERS = frozenset(_OTHERS.split())
# Plutonium; NH, OG and the like name nitrogens and oxygens, not nihonium and oganesson
_HEAVIEST = 94
# Ions by their CHARMM names
_IONS = {"SOD": 11, "POT": 19, "CLA": 17, "CAL": 20, "CES": 55, "LIT": 3, "RUB": 37, "CAD": 48}


def atomic_number(label: str) -> int | None:
    """The atomic number that a label says, 0 for a dummy atom, None if it says none.

    A label is a symbol in any case, which digits and signs may follow: "Fe", "CL", "O2-", "C_12".

    >>> atomic_number("Fe3+"), atomic_number("X"), atomic_number("water")
    (26, 0, None)
    """
    match = re.fullmatch(r"([A-Za-z]{1,2})([^A-Za-z].*)?", label)
    return _NUMBERS.get(match.group(1).upper()) if match else None


def biomolecular_number(name: str, *, ion: bool) -> int:
    """The atomic number of an atom by its name in a PDB or GRO file; 0 if there is none to see.

    ion: the atom is a residue by itself and the residue bears its name.

    >>> biomolecular_number("CA", ion=False), biomolecular_number("CA", ion=True)
    (6, 20)
    """
    letters = "".join(c for c in name.upper() if c.isalpha())
    if ion and letters in _IONS:
        return _IONS[letters]
    number = _NUMBERS.get(letters, 0)
    if 0 < number <= _HEAVIEST and (ion or letters not in _NAMES_OF_OTHERS):
        return number
    return _NUMBERS.get(letters[:1], 0)
