/** Where a layout is: its name, and the tenant that shares it where it is not the user's own. */
export interface Place {
  name: string;
  tenant?: string | undefined;
}

/** A place as it stands in a link behind `#/layout/`: the user, or `@` and the tenant. */
export function linkOf({ name, tenant }: Place, user: string): string {
  return `#/layout/${encodeURIComponent(tenant === undefined ? user : `@${tenant}`)}/${encodeURIComponent(name)}`;
}

/** The place of a link; `other`: the user whose own it is, where that is somebody else. */
export function placeOf(owner: string, name: string, user: string): Place & { other?: string } {
  if (owner === user) return { name };
  return owner.startsWith("@") ? { name, tenant: owner.slice(1) } : { name, other: owner };
}
