/** What wants a person's approval, as `/system/approvals` tells it. */
export interface Approval {
  approval: string;
  request: "write" | "execute";
  path: string;
  principal: string;
  status: "pending" | "approved" | "rejected" | "used" | "expired";
  asked: string;
  expires: string;
  value?: unknown;
  /** Of a plan: the steps that want it. */
  steps?: string[];
  by?: string;
  reason?: string;
}

/** Those that wait for this person: nobody decides on what they asked for themselves. */
export function decidable(all: Approval[], principal: string | undefined, may: boolean): Approval[] {
  return may ? all.filter((one) => one.status === "pending" && one.principal !== principal) : [];
}
