"""When two places of a sheet, or two directions in it, are one, and two families are two.

Coordinates have 16 digits, of which meshes from files keep fewer and cuts of lines lose some.
"""

#: Largest distance of places that are one, over the extent of the sheet or its distance from the
#: origin, whichever rounds them.
SAME_PLACE = 1e-8
#: Largest angle between directions that are one, rad.
SAME_DIRECTION = 1e-6
#: Smallest |sin| of the angle between the families.
LEAST_CROSSING = 1e-3
