"""How long it lasts: the page for hours with a restless audience, and what becomes of it."""
