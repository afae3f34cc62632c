"""Acts that people sign or approve: proposals, two-person rules, signed rules of a site."""
